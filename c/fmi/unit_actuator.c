/* The identified model of an actuator as the unit of an FMU: ActuatorModel.predict tick by tick, with its bits.
 *
 * Its velocity is that around a tick, FMU_LOOK ticks before it and after. What is computed in a tick is so that of FMU_LOOK ticks
 * ago; as much of the dead time as there is makes up for it, and the output `late` has the rest.
 */
#include <math.h>
#include <string.h>

#include "asymmetry.h"
#include "unit.h"

enum { VOLTS, DISPLACEMENT, LATE, BEYOND, OFFSET, WEIGHTS };
static const fmu_model *const model = &fmu_settings;

static double clipped(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

/* ---- Hysteresis: what a tick is made of ---------------------------------------------------------------------------- */

/* A curve of the voltage, beyond -1 and 1 a straight line; V. */
static double curve(int which, double s)
{
    double in = clipped(s, -1, 1), q = 1 + 4 * in * in, f, slope;
    if (which == 2) {
        f = in / sqrt(q);
        slope = 1 / (q * sqrt(q));
    } else {
        f = which == 0 ? in + 0.45 * in * in : in - 0.45 * in * in;
        slope = which == 0 ? 1 + 0.9 * in : 1 - 0.9 * in;
    }
    return model->half * (f + slope * (s - in));
}

/* What a state of Duhem of s, and the one of s^2, approach on a way up or down; V. */
static void settled(double s, double lag, double *of_s, double *of_square)
{
    *of_s = (s - lag) * model->half;
    *of_square = (0.5 * s * s - (s - lag) * lag) * model->half;
}

static void move_duhem(fmu_unit *u, double s)
{
    double sign = s - u->s < 0 ? -1 : 1;
    for (int i = 0; i < FMU_DUHEM; i++) {
        double lag = sign / model->beta[i], gone = exp(-model->beta[i] * fabs(s - u->s)), to[2], from[2];
        settled(s, lag, &to[0], &to[1]);
        settled(u->s, lag, &from[0], &from[1]);
        for (int k = 0; k < 2; k++) u->duhem[2 * i + k] = to[k] + gone * (u->duhem[2 * i + k] - from[k]);
    }
    u->s = s;
}

/* The sum of the branches, um. */
static double branches(fmu_unit *u, double x)
{
    double term[FMU_BRANCHES + 1] = {0};
    int n = 0;
    if (FMU_BRANCHES == 0) return 0;
    double s = (x - model->low) / model->half - 1;
    for (int i = 0; i < FMU_CURVES; i++) {
        ts_play_bank(curve(model->curve[i], s) - model->curve_at_zero[i], model->curve_r, u->curved[i], FMU_CURVED);
        for (int k = 0; k < FMU_CURVED; k++) term[n++] = u->curved[i][k];
    }
    ts_play_bank(x, model->cell_r, u->levelled, FMU_LEVELS);
    for (int i = 0, k = 0; i < FMU_LEVELS; i++) {
        for (int j = i; j < FMU_LEVELS; j++, k++) {
            double above = u->levelled[i] > model->cell_low[k] ? u->levelled[i] : model->cell_low[k];
            term[n++] = (above < model->cell_high[k] ? above : model->cell_high[k]) - model->cell_at_zero[k];
        }
    }
    move_duhem(u, s);
    for (int i = 0; i < 2 * FMU_DUHEM; i++) term[n++] = u->duhem[i];
    return ts_dot(term, model->branch, FMU_BRANCHES);
}

/* ---- Displacement -------------------------------------------------------------------------------------------------- */

/* The strain of a tick at a velocity, um. */
static double strain(const fmu_unit *u, const fmu_sample *p, double velocity)
{
    double w[FMU_PLAYS], known[FMU_TERMS + 1], rate = model->rate_scale * velocity;
    for (int i = 0; i < FMU_PLAYS; i++) w[i] = u->a[i] + rate * u->b[i];
    memcpy(known, p->known, sizeof known);
    if (model->lag >= 0) known[model->lag] = velocity;
    double y = ts_dot(w, p->play, FMU_PLAYS) + p->further + ts_dot(known, u->weight, FMU_TERMS);
    return ts_with_asymmetry(u->weight + model->asymmetry, FMU_ASYMMETRIES, model->stroke, y);
}

static fmu_sample *sample(fmu_unit *u, uint64_t tick) { return &u->sample[tick % (2 * FMU_LOOK + 1)]; }

/* Everything that follows the voltage goes on by a tick. */
static void move(fmu_unit *u, uint64_t tick, double x)
{
    fmu_sample *p = sample(u, tick);
    if (tick == 0) u->first = u->volts = x;
    ts_play_bank(x, model->r, p->play, FMU_PLAYS);
    memcpy(sample(u, tick + 1)->play, p->play, sizeof p->play);
    for (int i = 0; i < FMU_CREEPS; i++) {
        double followed = u->creep[i] + model->creep[i] * (u->volts - u->first);
        u->creep[i] = -followed * (model->creep[i] - 1);
        p->known[i] = u->first + followed;
    }
    if (model->offset >= 0) p->known[model->offset] = 1;
    p->further = branches(u, x);
    p->still = strain(u, p, 0);
    u->volts = x;
}

/* The strain of FMU_LOOK ticks ago, um, with the velocity around it. */
static double strain_of_past(fmu_unit *u, uint64_t tick)
{
    uint64_t from = tick > 2 * FMU_LOOK ? tick - 2 * FMU_LOOK : 0;
    double rise = sample(u, tick)->still - sample(u, from)->still;
    double velocity = rise * model->sample_rate / (double)(tick - from);
    double seen = model->velocity > 0 ? clipped(velocity, -model->velocity, model->velocity) : velocity;
    u->fast = model->fastest > 0 && fabs(velocity) > model->fastest;
    double beyond = model->proven * (velocity - seen), late = u->faster + model->faster[0] * beyond;
    u->faster = beyond * model->faster[1] + late * model->faster[2];
    return strain(u, sample(u, tick - FMU_LOOK), seen) - late;
}

/* ---- Stage, lag and dead time -------------------------------------------------------------------------------------- */

/* What went into a line of so many ticks as long ago; 0 before the start. */
static double delayed(double *line, int ticks, uint64_t tick, double x)
{
    line[tick % (unsigned)(ticks + 1)] = x;
    return line[(tick + 1) % (unsigned)(ticks + 1)];
}

static double through_stage(fmu_unit *u, uint64_t tick, double strain)
{
    double x = delayed(u->dead, FMU_DEAD, tick, strain - u->rest), parts = 0;
    double taps = model->direct[0] * x + model->direct[1] * u->input[0] + model->direct[2] * u->input[1];
    u->input[1] = u->input[0];
    u->input[0] = x;
    for (int i = 0; i < FMU_SECTIONS; i++) {
        const double *c = model->section[i];
        double *state = u->section[i], y = state[0] + c[0] * x;
        state[0] = state[1] + x * c[1] - y * c[2];
        state[1] = -y * c[3];
        parts += y;
    }
    return u->rest + taps + parts;
}

static double through_lag(fmu_unit *u, uint64_t tick, double z)
{
    double x = z - u->rest, y = x;
    if (model->kept != 0) {
        y = u->lag + model->last * x;
        u->lag = x * model->before + y * model->kept;
    }
    double before = delayed(u->late, FMU_WHOLE + 1, tick, y), now = u->late[(tick + 2) % (FMU_WHOLE + 2)];
    return u->rest + (1 - model->part) * now + model->part * before;
}

/* ---- The unit ------------------------------------------------------------------------------------------------------ */

static void rest_at_0_volts(fmu_state *s)
{
    fmu_unit *u = &s->unit;
    const double *w = s->value + WEIGHTS;
    memset(u, 0, sizeof *u);
    for (int i = 0; i < FMU_PLAYS; i++) {
        u->a[i] = w[model->a[i]];
        u->b[i] = model->b[i] < 0 ? 0 : w[model->b[i]];
    }
    for (int i = 0; i < FMU_TERMS; i++) u->weight[i] = w[FMU_OF_PLAYS + i];
    if (FMU_BRANCHES == 0) return;
    u->s = -model->low / model->half - 1;
    for (int i = 0; i < FMU_DUHEM; i++) {
        u->duhem[2 * i] = model->half * u->s;
        u->duhem[2 * i + 1] = model->half * (0.5 * (u->s * u->s));
    }
}

bool fmu_begin(fmu_state *s, char *said)
{
    (void)said;
    rest_at_0_volts(s);
    move(&s->unit, 0, 0);
    s->value[DISPLACEMENT] = model->zero + s->value[OFFSET] + sample(&s->unit, 0)->still;
    rest_at_0_volts(s);
    return true;
}

bool fmu_tick(fmu_state *s, int i, int of, char *said)
{
    (void)i, (void)of;
    fmu_unit *u = &s->unit;
    uint64_t tick = s->ticks;
    double x = s->value[VOLTS], z;
    if (!fmu_is_finite(s, VOLTS, said)) return false;
    move(u, tick, x);
    if (tick < FMU_LOOK) {
        z = sample(u, 0)->still;
    } else {
        z = strain_of_past(u, tick);
        if (tick == FMU_LOOK) u->rest = z;
        if (model->staged) z = through_stage(u, tick, z);
        if (model->delayed) z = through_lag(u, tick, z);
    }
    s->value[DISPLACEMENT] = model->zero + s->value[OFFSET] + z;
    s->value[BEYOND] = x < model->volts_low || x > model->volts_high || u->fast;
    return true;
}

void fmu_moved(fmu_state *s)
{
    (void)s;
}
