/* The controller as the unit of an FMU: in each tick the measurement of an earlier voltage, then the next voltage. */
#include <math.h>

#include "status.h"
#include "unit.h"

enum { Z_D, ZDOT_D, ZDDOT_D, Z, MEASURED, HOLD, VOLTS, INNOVATION, FLAGS, VOLTAGE_MIN, VOLTAGE_MAX, SLEW_LIMIT, ACCELERATION, LATE };

const char *fmu_begin(fmu_state *s)
{
    ts_settings *settings = &s->unit.settings;
    *settings = fmu_settings;
    settings->voltage_min = s->value[VOLTAGE_MIN];
    settings->voltage_max = s->value[VOLTAGE_MAX];
    double slew = s->value[SLEW_LIMIT]; /* what is as it was keeps its bits */
    if (slew != fmu_variables[SLEW_LIMIT].start) settings->slew = slew < fmu_variables[SLEW_LIMIT].high ? slew * FMU_TICK : INFINITY;
    ts_status status = ts_controller_init(&s->unit.controller, settings);
    return status == TS_OK ? NULL : ts_status_setting(status);
}

/* Bit i is member i of ts_flags. */
static double flag_bits(const ts_flags *flags)
{
    const bool *flag = (const bool *)flags;
    unsigned bits = 0;
    for (unsigned i = 0; i < sizeof *flags / sizeof *flag; i++) bits |= (unsigned)flag[i] << i;
    return bits;
}

const char *fmu_tick(fmu_state *s, int i, int of)
{
    (void)of;
    ts_controller *c = &s->unit.controller;
    const double *v = s->value;
    double t = i * FMU_TICK, acceleration = v[ACCELERATION] != 0 ? v[ZDDOT_D] : 0;
    for (int name = Z_D; name <= ZDDOT_D; name++)
        if (!isfinite(v[name])) return fmu_variables[name].name;
    ts_controller_hold(c, v[HOLD] != 0);
    bool due = i == 0 && (double)c->counters.commands > v[LATE] && v[MEASURED] != 0;
    if (due) ts_controller_adapt(c, v[Z], (int)v[LATE]);
    double z_d = v[Z_D], zdot_d = v[ZDOT_D];
    if (i > 0) { /* within a step the motion goes on */
        z_d += t * (zdot_d + t / 2 * acceleration);
        zdot_d += t * acceleration;
    }
    ts_controller_follow(c, z_d, zdot_d, v[ACCELERATION] != 0 ? v[ZDDOT_D] : NAN, NAN, NULL, &s->value[VOLTS]);
    s->value[INNOVATION] = c->innovation;
    s->value[FLAGS] = flag_bits(&c->flags);
    return NULL;
}

void fmu_moved(fmu_state *s)
{
    s->unit.controller.settings = &s->unit.settings;
}
