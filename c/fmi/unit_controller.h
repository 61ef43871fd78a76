/* The controller as the unit of an FMU. */
#ifndef TRUESTROKE_FMI_CONTROLLER_H
#define TRUESTROKE_FMI_CONTROLLER_H

#include "truestroke.h"

typedef struct {
    ts_settings settings;
    ts_controller controller;
} fmu_unit;

extern const ts_settings fmu_settings;

#endif
