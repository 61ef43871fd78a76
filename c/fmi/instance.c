#include "instance.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define SAY(m, ...) ((void)snprintf((m)->said, sizeof (m)->said, __VA_ARGS__))

void fmu_reset(fmu_instance *m)
{
    memset(m, 0, sizeof *m);
    for (int i = 0; i < FMU_VARIABLES; i++) m->now.state.value[i] = fmu_variables[i].start;
}

bool fmu_start(fmu_instance *m)
{
    for (int i = 0; i < FMU_VARIABLES; i++) {
        const fmu_variable *v = &fmu_variables[i];
        double value = m->now.state.value[i];
        if (v->role != FMU_PARAMETER || (value >= v->low && value <= v->high)) continue;
        SAY(m, "%s = %.10g%s%s: must be from %.6g to %.6g", v->name, value, *v->unit ? " " : "", v->unit, v->low, v->high);
        return false;
    }
    if (!fmu_begin(&m->now.state, m->said)) return false;
    m->now.phase = FMU_STEPPING;
    return true;
}

bool fmu_is_finite(const fmu_state *s, int which, char *said)
{
    const fmu_variable *v = &fmu_variables[which];
    double value = s->value[which];
    if (!isfinite(value)) (void)snprintf(said, FMU_SAID, "%s = %g%s%s: must be finite", v->name, value, *v->unit ? " " : "", v->unit);
    return isfinite(value);
}

double *fmu_place(fmu_instance *m, unsigned which, fmu_type type, bool set)
{
    if (which >= FMU_VARIABLES || fmu_variables[which].type != type) {
        SAY(m, "there is no variable %u of this type", which);
        return NULL;
    }
    const fmu_variable *v = &fmu_variables[which];
    if (set && (v->role == FMU_OUTPUT || (v->role == FMU_PARAMETER && m->now.phase >= FMU_STEPPING))) {
        SAY(m, "%s is %s", v->name, v->role == FMU_OUTPUT ? "an output: it cannot be set" : "set before the first step only");
        return NULL;
    }
    return &m->now.state.value[which];
}

double fmu_time(const fmu_instance *m)
{
    return m->now.begin + (double)m->now.state.ticks * FMU_TICK;
}

bool fmu_step(fmu_instance *m, double now, double step)
{
    double ticks = round(step / FMU_TICK), due = fmu_time(m);
    if (m->now.phase != FMU_STEPPING) {
        SAY(m, "a step before the initialisation, or after the end");
        return false;
    }
    if (!(fabs(step / FMU_TICK - ticks) <= 1e-6 * ticks && ticks >= 1 && ticks <= 1e9)) {
        SAY(m, "step = %.10g s: must be a multiple of the tick, %.10g s", step, FMU_TICK);
        return false;
    }
    if (!(fabs(now - due) < FMU_TICK / 2)) {
        SAY(m, "time = %.10g s: the last step ended at %.10g s", now, due);
        return false;
    }
    for (int i = 0; i < (int)ticks; i++) {
        if (!fmu_tick(&m->now.state, i, (int)ticks, m->said)) return false;
        m->now.state.ticks++;
    }
    return true;
}

void fmu_restore(fmu_instance *m, const fmu_saved *saved)
{
    m->now = *saved;
    fmu_moved(&m->now.state);
}

bool fmu_is(fmu_instance *m, const char *guid)
{
    bool same = guid && strcmp(guid, fmu_guid) == 0;
    if (!same) SAY(m, "guid %s: this FMU has %s", guid ? guid : "", fmu_guid);
    return same;
}

bool fmu_has_no(fmu_instance *m, const char *what)
{
    SAY(m, "this FMU has no %s", what);
    return false;
}
