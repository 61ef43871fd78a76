/* What is within an FMU: variables by number, one after the other, and calls that know nothing of FMI.
 *
 * Of all types the value is a double; variables.h, which is written with the FMU, has their number, names and bounds.
 */
#ifndef TRUESTROKE_FMI_UNIT_H
#define TRUESTROKE_FMI_UNIT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "variables.h"

typedef enum { FMU_PARAMETER, FMU_INPUT, FMU_OUTPUT } fmu_role;
typedef enum { FMU_REAL, FMU_INTEGER, FMU_BOOLEAN } fmu_type;

typedef struct {
    const char *name, *unit;
    fmu_type type;
    fmu_role role;
    double start, low, high;
} fmu_variable;

extern const fmu_variable fmu_variables[FMU_VARIABLES];
extern const char fmu_guid[];

typedef struct { /* plain data, but for what fmu_moved sets right */
    double value[FMU_VARIABLES];
    uint64_t ticks;
    fmu_unit unit;
} fmu_state;

enum { FMU_SAID = 256 }; /* bytes of a message */

/* With the parameters that are in `value`: at rest. False, and why in `said`, where they do not belong together. */
bool fmu_begin(fmu_state *s, char *said);

/* Tick i of the `of` ticks of a step. False, and why in `said`, where an input cannot be used; nothing has changed then. */
bool fmu_tick(fmu_state *s, int i, int of, char *said);

/* Whether an input is finite; else `said` says that it is not. */
bool fmu_is_finite(const fmu_state *s, int which, char *said);

/* After the state was copied to another place. */
void fmu_moved(fmu_state *s);

#endif
