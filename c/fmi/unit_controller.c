/* The controller as the unit of an FMU: in each tick the measurement of an earlier voltage, then the next voltage. */
#include <math.h>
#include <stdio.h>

#include "status.h"
#include "unit.h"

enum { Z_D, ZDOT_D, ZDDOT_D, Z, MEASURED, HOLD, VOLTS, INNOVATION, FLAGS, VOLTAGE_MIN, VOLTAGE_MAX, SLEW_LIMIT, ACCELERATION, LATE };

bool fmu_begin(fmu_state *s, char *said)
{
    ts_settings *settings = &s->unit.settings;
    *settings = fmu_settings;
    settings->voltage_min = s->value[VOLTAGE_MIN];
    settings->voltage_max = s->value[VOLTAGE_MAX];
    double slew = s->value[SLEW_LIMIT]; /* what is as it was keeps its bits */
    if (slew != fmu_variables[SLEW_LIMIT].start) settings->slew = slew < fmu_variables[SLEW_LIMIT].high ? slew * FMU_TICK : INFINITY;
    double low = settings->voltage_min, high = settings->voltage_max;
    ts_status status = ts_controller_init(&s->unit.controller, settings);
    if (!(low < high)) (void)snprintf(said, FMU_SAID, "voltage_min = %.10g V: must be below voltage_max, %.10g V", low, high);
    else if (status != TS_OK) (void)snprintf(said, FMU_SAID, "%s: out of range, or not in order", ts_status_setting(status));
    return status == TS_OK;
}

/* Bit i is member i of ts_flags. */
static double flag_bits(const ts_flags *flags)
{
    const bool *flag = (const bool *)flags;
    unsigned bits = 0;
    for (unsigned i = 0; i < sizeof *flags / sizeof *flag; i++) bits |= (unsigned)flag[i] << i;
    return bits;
}

/* Adapts to z; false where the first one is further away than the stroke allows: its unit or zero is another. */
static bool take_measurement(ts_controller *c, double z, int late, char *said)
{
    if (ts_controller_adapt(c, z, late) != TS_BEYOND_REACH) return true;
    double volts = c->x[(c->counters.commands - 1 - (uint64_t)late) % TS_HISTORY];
    (void)snprintf(said, FMU_SAID, "z = %.10g um: must be within %.6g um of 0 at first, under %.6g V; zero the sensor, and look at its unit",
                   z, ts_reach(c->settings, volts), volts);
    return false;
}

bool fmu_tick(fmu_state *s, int i, int of, char *said)
{
    (void)of;
    ts_controller *c = &s->unit.controller;
    const double *v = s->value;
    double t = i * FMU_TICK, acceleration = v[ACCELERATION] != 0 ? v[ZDDOT_D] : 0;
    for (int name = Z_D; name <= ZDDOT_D; name++)
        if (!fmu_is_finite(s, name, said)) return false;
    ts_controller_hold(c, v[HOLD] != 0);
    bool due = i == 0 && (double)c->counters.commands > v[LATE] && v[MEASURED] != 0;
    if (due && !take_measurement(c, v[Z], (int)v[LATE], said)) return false;
    double z_d = v[Z_D], zdot_d = v[ZDOT_D];
    if (i > 0) { /* within a step the motion goes on */
        z_d += t * (zdot_d + t / 2 * acceleration);
        zdot_d += t * acceleration;
    }
    ts_controller_follow(c, z_d, zdot_d, v[ACCELERATION] != 0 ? v[ZDDOT_D] : NAN, NAN, NULL, &s->value[VOLTS]);
    s->value[INNOVATION] = c->innovation;
    s->value[FLAGS] = flag_bits(&c->flags);
    return true;
}

void fmu_moved(fmu_state *s)
{
    s->unit.controller.settings = &s->unit.settings;
}
