/* The simulated stack as the unit of an FMU. */
#ifndef TRUESTROKE_FMI_PLANT_H
#define TRUESTROKE_FMI_PLANT_H

#include <stdint.h>

#include "plant.h"

#define FMU_SAMPLES 1000 /* of noise in a tick, at most */

typedef struct {
    ts_plant plant;
    uint64_t random;
} fmu_unit;

extern const ts_plant_settings fmu_settings;

#endif
