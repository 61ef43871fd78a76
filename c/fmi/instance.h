/* One instance of an FMU, as both versions of FMI have it: what a saved state holds, steps, and what is wrong in words. */
#ifndef TRUESTROKE_FMI_INSTANCE_H
#define TRUESTROKE_FMI_INSTANCE_H

#include <stdbool.h>

#include "unit.h"

#if defined(_WIN32)
#define FMU_EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define FMU_EXPORT __attribute__((visibility("default")))
#else
#define FMU_EXPORT
#endif

typedef enum { FMU_INSTANTIATED, FMU_INITIALISING, FMU_STEPPING, FMU_TERMINATED } fmu_phase;

typedef struct { /* plain data */
    fmu_state state;
    fmu_phase phase;
    double begin; /* s: time of the first tick */
} fmu_saved;

typedef struct {
    fmu_saved now;
    char said[FMU_SAID]; /* why the last call has failed; complete: many importers do not fill in what a format asks for */
} fmu_instance;

/* All values are those of the start. */
void fmu_reset(fmu_instance *m);

/* The end of the initialisation: parameters are checked, and the unit begins. */
bool fmu_start(fmu_instance *m);

/* The place of a variable of this type, to be read or set; NULL where it may not be. */
double *fmu_place(fmu_instance *m, unsigned which, fmu_type type, bool set);

/* The present time, s. */
double fmu_time(const fmu_instance *m);

/* From `now` on for `step`, s: whole ticks. */
bool fmu_step(fmu_instance *m, double now, double step);

/* Back to what was saved. */
void fmu_restore(fmu_instance *m, const fmu_saved *saved);

/* Whether it is that of this FMU. */
bool fmu_is(fmu_instance *m, const char *guid);

/* Says that this FMU has none of what is asked for; false. */
bool fmu_has_no(fmu_instance *m, const char *what);

#endif
