#include "lanes.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#define LOWER ((ts_real)0.7)      /* factor of the filter's corner where it was not low enough */
#define NOT_BELOW ((ts_real)0.2) /* of the known resonance: a slower error is that of the motion */
#define ALARMS 0.1                /* s: over which the rate of sudden changes is taken, */
#define PAUSE 100                 /* 1/s: from which on the feedback pauses, */
#define RESUME 20                 /* 1/s: and below which it continues; */
#define AT_FIRST 60               /* 1/s: that of the start, so that it begins a tenth of a second later */
#define REST_PERIODS 6            /* of the oscillation: longest pause of adaptation, */
#define REST_HALF_WAVES 7         /* and half-waves of the ringing after which it continues */

#define RINGS 4                   /* times the noise's: mean square of the second difference of the error where the stage rings */
#define JUMP 16                   /* times the noise's: what one tick may add to it; a jump is no ringing */
#define RINGING_RATE 50           /* 1/s: how fast that mean follows */
#define FOUND ((ts_real)0.2)      /* relative standard deviation of the inertia of a resonance that an oscillation has */
#define STEP_TERMS 32             /* of a series: enough up to half of the sample rate */
#define FOUND_DAMPING ((ts_real)0.02) /* of a stage that was found by its oscillation, */
#define FOUND_FILTER ((ts_real)0.6) /* corner of the law's filter over its resonance, */
#define SMOOTH 8                 /* times the third difference of velocities: no more than the sum of their first ones */
#define FOUND_LAG ((ts_real)0.1)  /* and standard deviations of what lag and inertia of it miss, over 1 / w0 and 1 / w0^2 */
#define FOUND_INERTIA ((ts_real)0.05)
#define CERTAIN ((ts_real)0.02)   /* relative deviation of a resonance that is put into the model */
#define MOVED ((ts_real)0.015)    /* of the resonance of the model: one that is shown and differs by so much replaces it */
#define FURTHER ((ts_real)0.15)   /* unless by so much */
#define DOUBT ((ts_real)0.01)     /* of the motion's range: an error that the dynamics of the settings should not leave */
#define FALLEN ((ts_real)0.8)     /* of that error: learning makes it smaller */
#define LASTS 8                   /* windows in which it does not */
#define ELSEWHERE ((ts_real)0.03) /* of the first resonance of the settings: one that differs by so much, where learning has failed */
#define DRIVEN ((ts_real)0.5)     /* share of the plays: what our voltage does not drive is of another axis, or comes from outside */
#define ANOTHER ((ts_real)0.07)   /* of the first resonance of the settings: one that differs by so much is that of another stage */
#define SLOWEST ((ts_real)0.025)  /* of the resonance: a slower motion does not need it */
#define NOISY 9                   /* times the variance of a measurement: nor does a smaller error */
#define FREE 6                    /* half-waves of the ringing while weights are held, which shows the resonance, */
#define DECAYED ((ts_real)0.98)   /* of the first of them: the last one is smaller, or something drives it */
#define MOST_CAUTION ((ts_real)0.1) /* of the motion's range: the largest error that counts as noise after learning has failed */
#define CAUTIOUS 100            /* times the variance of a measurement: from there on the law follows no drift */
#define AS_GOOD_AS_NONE ((ts_real)1e-6) /* of the prior's variance: of a weight that stays */

/* ---- Settings ---------------------------------------------------------------------------------------------------- */

static bool bounded(ts_real x) { return x >= -TS_LARGEST && x <= TS_LARGEST; }
static bool positive(ts_real x) { return x >= 1 / TS_LARGEST && x <= TS_LARGEST; }
static bool fraction(ts_real x) { return x >= 0 && x <= 1; }

/* Whether the poles of (b0 + b1 q^-1) / (1 + a1 q^-1 + a2 q^-2) are within the unit circle. */
static bool stable_section(const ts_real *q)
{
    return bounded(q[0]) && bounded(q[1]) && q[3] < 1 && q[3] > -1 && q[2] < 1 + q[3] && q[2] > -1 - q[3];
}

/* The same of (b0 + b1 q^-1 + b2 q^-2) / (1 + a1 q^-1 + a2 q^-2). */
static bool stable_biquad(const ts_real *q)
{
    const ts_real poles[4] = {q[0], q[1], q[3], q[4]};
    return stable_section(poles) && bounded(q[2]);
}

static bool ascends_from_zero(const ts_real *r, int n)
{
    if (r[0] != 0) return false;
    for (int i = 1; i < n; i++)
        if (!(r[i] > r[i - 1]) || !bounded(r[i])) return false;
    return true;
}

static bool partial_sums_positive(const ts_real *w, int n)
{
    ts_real sum = 0;
    for (int i = 0; i < n; i++) {
        sum += w[i];
        if (!positive(sum)) return false;
    }
    return true;
}

static ts_status check_model(const ts_settings *s)
{
    if (s->plays < 1 || s->plays > TS_MAX_PLAYS) return TS_BAD_PLAYS;
    if (!ascends_from_zero(s->thresholds, s->plays)) return TS_BAD_THRESHOLDS;
    if (s->dead_zones < 1 || s->dead_zones > TS_MAX_DEAD_ZONES) return TS_BAD_DEAD_ZONES;
    if (!ascends_from_zero(s->dead_zone_thresholds, s->dead_zones)) return TS_BAD_DEAD_ZONES;
    if (!partial_sums_positive(s->dead_zone_weights, s->dead_zones)) return TS_BAD_DEAD_ZONE_WEIGHTS;
    static const int most[TS_TERMS] = TS_MOST_WEIGHTS;
    for (int i = 0; i < TS_TERMS; i++)
        if (s->terms[i] < 0 || s->terms[i] > most[i]) return TS_BAD_TERMS;
    if (s->terms[TS_COUPLING_LAG] != s->terms[TS_COUPLING] || s->terms[TS_COUPLING_INERTIA] != s->terms[TS_COUPLING]) return TS_BAD_TERMS;
    if (ts_parameters(s) > TS_MAX_PARAMETERS) return TS_BAD_TERMS;
    for (int i = 0; i < s->terms[TS_CREEP]; i++)
        if (!(s->creep[i] > 0 && s->creep[i] <= 1)) return TS_BAD_TERMS;
    for (int i = 0; i < ts_parameters(s); i++)
        if (!bounded(s->initial_weights[i])) return TS_BAD_WEIGHTS;
    return s->rate_scale >= 0 && bounded(s->rate_scale) ? TS_OK : TS_BAD_RATE_SCALE;
}

static ts_status check_rls(const ts_settings *s)
{
    bool good = s->forgetting >= (ts_real)1e-3 && s->forgetting <= 1 && positive(s->regularization) && bounded(s->covariance_limit)
                && s->covariance_limit >= (ts_real)ts_parameters(s) / s->regularization;
    return good ? TS_OK : TS_BAD_RLS;
}

/* Variances above 0 and correlations within -1 to 1: the checks that need no factorisation. */
static bool check_prior(const ts_settings *s)
{
    ts_real variance[TS_MAX_PARAMETERS];
    const ts_real *P0 = s->prior;
    for (int i = 0, m = ts_parameters(s); i < m; i++) {
        int from = s->prior_from[i];
        if (from > i || from % TS_LANES || P0 + (i - from) >= s->prior + TS_MAX_PRIOR) return false;
        variance[i] = P0[i - from];
        bool good = variance[i] > 0 && variance[i] <= TS_LARGEST * TS_LARGEST;
        for (int j = from; j < i; j++, P0++) good = good && *P0 * *P0 <= variance[i] * variance[j] * (ts_real)1.0001;
        if (!good) return false;
        P0++;
    }
    return true;
}

static ts_status check_kalman(const ts_settings *s)
{
    const ts_kalman_settings *k = &s->kalman;
    if (ts_parameters(s) > TS_MAX_LEARNED) return TS_BAD_TERMS;
    bool good = k->filter > 0 && k->filter <= 1 && fraction(k->noise_rate) && fraction(k->ringing_rate)
                && fraction(k->prior_return) && fraction(k->change_rate) && fraction(k->usual_rate) && fraction(k->change_share)
                && k->model_error >= 0 && bounded(k->model_error) && k->change_threshold > 0 && k->refractory >= 0
                && fraction(k->change_gain) && fraction(k->change_hysteresis) && k->outlier > 0 && k->outliers >= 0 && positive(s->first_noise);
    const ts_oscillation_settings *o = &s->oscillation;
    if (o->tick != 0)
        good = good && o->tick > 0 && o->corner > 0 && o->corner <= 1 && fraction(o->fast) && fraction(o->slow)
               && fraction(o->motion_rate) && o->noise_share >= 0 && bounded(o->noise_share) && o->floor > 0 && bounded(o->floor)
               && o->large > 0 && bounded(o->large);
    const ts_guard_settings *g = &s->guard;
    good = good && g->window >= 0 && g->recall >= 0 && g->recall <= TS_LONGEST_RECALL && fraction(g->range_rate) && g->burst >= 0 && bounded(g->burst) && (g->window == 0 || positive(g->floor));
    good = good && (s->resonance >= (ts_real)1e-6 || !(s->resonance < 0 || s->resonance > 0)) && s->resonance <= 1 && (o->tick > 0 || !(s->resonance > 0));
    return good && check_prior(s) ? TS_OK : TS_BAD_KALMAN;
}

static ts_status check_dynamics(const ts_dynamics *d)
{
    bool good = d->sections >= 0 && d->sections <= TS_SECTIONS && d->others >= 0 && d->others <= TS_SECTIONS && d->modes >= 0 && d->modes <= TS_SECTIONS && d->dead >= 0
                && d->dead < TS_HISTORY / 2 && bounded(d->lead[0]) && bounded(d->lead[1])
                && bounded(d->sensor[0]) && bounded(d->sensor[1]);
    if (!good || (d->known && !(d->first > 0 && d->first < 1))) return TS_BAD_DYNAMICS;
    for (int i = 0; i < d->sections; i++) good = good && stable_section(d->section[i]);
    for (int i = 0; i < d->others; i++) good = good && stable_section(d->rest[i]);
    for (int i = 0; i < d->modes; i++) good = good && stable_biquad(d->mode[i]);
    for (int i = 0; i < 3; i++) good = good && bounded(d->direct[i]) && bounded(d->notch[i]) && bounded(d->quiet[i]);
    for (int i = 0; i < TS_TAPS; i++) good = good && bounded(d->tap[i]);
    return good ? TS_OK : TS_BAD_DYNAMICS;
}

static ts_status check_sensor(const ts_settings *settings)
{
    const ts_sensor *s = &settings->sensor;
    bool passes = s->share > 0 || s->lag > 0, none = s->ticks == 0 && !passes;
    if (passes && ts_parameters(settings) > TS_MAX_SENSED) return TS_BAD_SENSOR;
    bool good = s->ticks >= 0 && s->ticks < TS_HISTORY / 2 && fraction(s->share) && s->lag >= 0 && bounded(s->lag) && s->pole >= 0 && s->pole < 1
                && fraction(s->now) && fraction(s->before) && bounded(s->slow[0]) && bounded(s->slow[1]);
    return good && (none || !settings->dynamics.known) ? TS_OK : TS_BAD_SENSOR;
}

static ts_status check_feedback(const ts_feedback *f)
{
    bool good = f->filters >= 0 && f->filters <= TS_FEEDBACKS && f->most >= 0 && bounded(f->most);
    for (int i = 0; good && i < f->filters; i++) good = stable_biquad(f->filter[i]);
    return good ? TS_OK : TS_BAD_FEEDBACK;
}

static ts_status check(const ts_settings *s)
{
    ts_status status = check_model(s);
    if (status != TS_OK) return status;
    ts_status law = s->law == TS_LAW_RLS ? check_rls(s) : check_kalman(s);
    if (law != TS_OK) return law;
    ts_status dynamics = check_dynamics(&s->dynamics);
    if (dynamics != TS_OK) return dynamics;
    if (s->dynamics.known && s->law != TS_LAW_KALMAN) return TS_BAD_DYNAMICS;
    ts_status sensor = check_sensor(s);
    if (sensor != TS_OK) return sensor;
    ts_status feedback = check_feedback(&s->feedback);
    if (feedback != TS_OK) return feedback;
    if (!positive(s->slope_min) || !(s->slope_min < s->slope_max) || !positive(s->slope_max)) return TS_BAD_SLOPE;
    if (!(s->voltage_min < s->voltage_max) || !bounded(s->voltage_min) || !bounded(s->voltage_max) || !(s->slew > 0))
        return TS_BAD_VOLTAGE;
    bool good = s->velocity_limit >= 0 && bounded(s->velocity_limit) && positive(s->stroke) && positive(s->measurement_limit) && s->smoothing >= 0 && s->smoothing < 1
                && fraction(s->trim) && (positive(s->oscillation.tick) || !(s->oscillation.tick < 0 || s->oscillation.tick > 0));
    return good ? TS_OK : TS_BAD_LIMIT;
}

/* Place of the first weight of a known term: behind a_i of all plays, b_i of those that have one, and the terms before it. */
static int column(const ts_settings *s, ts_term term)
{
    int m = s->plays;
    for (int i = 0; i < s->plays; i++) m += s->rate_dependent[i];
    for (int i = 0; i < (int)term; i++) m += s->terms[i];
    return m;
}

int ts_parameters(const ts_settings *s)
{
    return column(s, TS_TERMS);
}

static ts_prior prior_of(const ts_settings *s)
{
    return (ts_prior){s->prior, s->prior_from};
}

/* Entries of the prior of the first n weights. */
static int prior_entries(const ts_settings *s, int n)
{
    int entries = 0;
    for (int i = 0; i < n; i++) entries += i + 1 - s->prior_from[i];
    return entries;
}

/* ---- Small steps --------------------------------------------------------------------------------------------------- */

/* The stage: that of the settings, or the one that was found. */
static const ts_dynamics *dynamics_of(const ts_controller *c)
{
    return c->found.known ? &c->found : &c->settings->dynamics;
}

/* Whether the dynamics of the settings are in use. */
static bool is_given(const ts_controller *c)
{
    return c->settings->dynamics.known && !c->found.known;
}

/* Whether the inertia of the stage is learned from the measured acceleration. */
static bool measures_inertia(const ts_controller *c)
{
    const ts_settings *s = c->settings;
    return s->terms[TS_INERTIA] && !dynamics_of(c)->known && s->law == TS_LAW_KALMAN && s->oscillation.tick > 0;
}

static ts_real within(ts_real x, ts_real low, ts_real high)
{
    return x < low ? low : x > high ? high : x;
}

static ts_real through_dead_zones(const ts_settings *s, ts_real z)
{
    return ts_dead_zones(z, s->dead_zone_thresholds, s->dead_zone_weights, s->dead_zones);
}

/* Creep states follow the voltage of the tick before, so that they are known before the next one is chosen. */
static void remember_creep(ts_memory *memory, const ts_settings *s)
{
    for (int i = 0; i < s->terms[TS_CREEP]; i++) memory->creep[i] += s->creep[i] * (memory->play[0] - memory->creep[i]);
}

static void remember_voltage(ts_memory *memory, const ts_settings *s, ts_real x)
{
    ts_play_bank(x, s->thresholds, memory->play, s->plays);
    memory->ticks++;
}

/* The part of the regressor that is known before the voltage is chosen; u is the place of the first of these terms. */
static void known_terms(const ts_settings *s, const ts_memory *memory, const ts_motion *d, ts_real *u)
{
    const int *n = s->terms;
    ts_real along = within((d->z_d + d->ahead) / s->stroke, -1, 2); /* further out a polynomial is meaningless, and would overflow */
    ts_real first = 4 * along * (1 - along);
    for (int i = 0; i < n[TS_CREEP]; i++) *u++ = memory->creep[i];
    for (int i = 0; i < n[TS_LAG]; i++) *u++ = d->zdot_d;
    for (int i = 0; i < n[TS_INERTIA]; i++) *u++ = d->zddot_d;
    for (int i = 0; i < n[TS_OFFSET]; i++) *u++ = 1;
    if (n[TS_ASYMMETRY] > 0) *u++ = first;
    if (n[TS_ASYMMETRY] > 1) *u++ = 2 * first * (1 - 2 * along);
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < n[TS_COUPLING]; i++) *u++ = d->others[i][k];
}

/* (20), and the known terms. */
static void regressor(const ts_settings *s, const ts_memory *memory, const ts_motion *d, ts_real *u)
{
    for (int i = 0; i < s->plays; i++) {
        *u++ = memory->play[i];
        if (s->rate_dependent[i]) *u++ = s->rate_scale * d->zdot_d * memory->play[i];
    }
    known_terms(s, memory, d, u);
}

/* ---- The arrows of Fig. 5: command ----------------------------------------------------------------------------------- */

/* Where the motion of the last command is kept; 0 before the first. */
static int last_slot(const ts_controller *c)
{
    return c->counters.commands > 0 ? (int)((c->counters.commands - 1) % TS_HISTORY) : 0;
}

/* The term of the inertia where the first resonance is at `frequency` cycles per tick, s; 0: not known. */
static ts_real inertia_of(const ts_settings *s, ts_real frequency)
{
    ts_real w = 2 * TS_PI * frequency;
    return frequency > 0 ? s->oscillation.tick / (w * w) : 0;
}

/* exp(d x) of so many ticks d of dead time, times the inverse of the hold, 1 - x^2 / 12 + x^4 / 240: coefficients of x to x^4. */
static void lead_of_dead_time(int dead, ts_real *first, ts_real *second, ts_real *third, ts_real *fourth)
{
    ts_real d = (ts_real)dead, square = d * d, cube = square * d, rest = (square * square - square) / 24;
    *first = d;
    *second = (6 * square - 1) / 12;
    *third = (2 * cube - d) / 12;
    *fourth = rest + (ts_real)1 / 240;
}

/* What a stage that was found asks of the hysteresis beyond z_d, um: 1 / G up to the fourth derivative, from the last four
 * velocities. A motion at a third of the resonance turns by up to a quarter of a radian in a tick. Where the velocities are noise,
 * or jump, their differences do not fall: there two derivatives are used. */
static ts_real ahead_of_found(const ts_controller *c, ts_real zdot_d, ts_real zddot_d)
{
    const ts_motion *past[3];
    for (uint64_t i = 0; i < 3; i++) past[i] = &c->motion[(c->counters.commands - 1 - i) % TS_HISTORY];
    ts_real newest = zdot_d - past[0]->zdot_d, before = past[0]->zdot_d - past[1]->zdot_d, oldest = past[1]->zdot_d - past[2]->zdot_d;
    ts_real second = newest - before, third = second - (before - oldest);
    if (SMOOTH * size_of(third) > size_of(newest) + size_of(before) + size_of(oldest))
        return c->found.lead[0] * zdot_d + c->found.lead[1] * zddot_d;
    ts_real w = 2 * TS_PI * c->stage.resonance, drag = 2 * FOUND_DAMPING / w, stiff = 1 / (w * w);
    ts_real l1, l2, l3, l4;
    lead_of_dead_time(c->found.dead, &l1, &l2, &l3, &l4);
    ts_real of_change = (stiff + l1 * drag + l2) * (newest + second / 2 + third / 3);
    ts_real of_jerk = (l1 * stiff + l2 * drag + l3) * (second + third);
    ts_real of_snap = (l2 * stiff + l3 * drag + l4) * third;
    return c->found.lead[0] * zdot_d + c->settings->oscillation.tick * (of_change + of_jerk + of_snap);
}

/* What the stage's dynamics ask of it: G^-1 z_d - z_d for slow motion where they are given, or the inertia z'' / w0^2 within a
 * tenth of the stroke. */
static ts_real ahead_of(const ts_controller *c, ts_real zdot_d, ts_real zddot_d)
{
    const ts_dynamics *g = dynamics_of(c);
    if (c->found.known) return ahead_of_found(c, zdot_d, zddot_d);
    if (g->known) return g->lead[0] * zdot_d + g->lead[1] * zddot_d;
    if (!(c->stage.inertia > 0) || c->counters.commands == 0) return 0;
    ts_real z = c->stage.inertia * (zdot_d - c->motion[last_slot(c)].zdot_d), most = c->settings->stroke / 10;
    return within(z, -most, most);
}

/* From the rates of this tick and of the last one, um/s^2; 0 at the first. */
static ts_real acceleration(const ts_controller *c, ts_real zdot_d)
{
    ts_real tick = c->settings->oscillation.tick;
    return c->counters.commands > 0 && tick > 0 ? (zdot_d - c->motion[last_slot(c)].zdot_d) / tick : 0;
}

/* The displacement of the known terms, um. */
static ts_real of_known_terms(const ts_controller *c, const ts_motion *d)
{
    ts_real u[TS_MAX_PARAMETERS];
    known_terms(c->settings, &c->now, d, u);
    return dot(c->w + c->of_plays, u, c->parameters - c->of_plays);
}

/* The displacement wanted of the plays, um: (11), the stage, the trim and the bumpless transfer, less the
 * known terms. */
static ts_real wanted_of_plays(const ts_controller *c, const ts_motion *d, ts_real known)
{
    return through_dead_zones(c->settings, d->z_d) + d->ahead + c->integral + c->feedback.sum + c->bumpless - known;
}

/* (7) and its partial sums at the rate zdot_d, each within its limits; returns whether one was moved. */
static bool rate_dependent_slopes(ts_controller *c, ts_real zdot_d)
{
    const ts_settings *s = c->settings;
    const ts_real *w = c->w;
    bool moved = false;
    ts_real rate = s->rate_scale * zdot_d, sum = 0;
    ts_real least = s->law == TS_LAW_KALMAN ? TS_IN_MOTION * s->slope_min : s->slope_min, most = s->slope_max;
    for (int i = 0, n = s->plays; i < n; i++) {
        ts_real w_h = *w++;
        if (s->rate_dependent[i]) w_h += rate * *w++;
        sum += w_h;
        bool inside = sum >= least && sum <= most;
        c->slopes[i] = inside ? sum : sum > most ? most : least;
        moved |= !inside;
    }
    return moved;
}

/* The output voltage: within the slew of the last one, and within the limits, whatever x is. */
static ts_real within_limits(ts_controller *c, ts_real x)
{
    const ts_settings *s = c->settings;
    ts_real last = c->now.play[0];
    bool number = x == x;
    if (!number) x = last;
    c->flags.slewed = x > last + s->slew || x < last - s->slew;
    if (c->flags.slewed) x = x > last ? last + s->slew : last - s->slew;
    c->flags.saturated = !number || x < s->voltage_min || x > s->voltage_max;
    if (x < s->voltage_min) return s->voltage_min;
    return x <= s->voltage_max ? x : s->voltage_max;
}

/* Displacement of the plays at the present voltage, um: the forward of the inverse, with the slopes that it last used. */
static ts_real sum_of_plays(const ts_controller *c)
{
    return ts_weighted_sum(c->slopes, c->now.play, c->settings->plays);
}

static void write_down(ts_controller *c, ts_real x, const ts_motion *d, ts_real known)
{
    int slot = (int)(c->counters.commands % TS_HISTORY);
    c->x[slot] = x;
    c->motion[slot] = *d;
    if (c->settings->law == TS_LAW_KALMAN) c->dynamics.strain[slot] = sum_of_plays(c) + known; /* according to the model */
    c->limited[slot] = c->flags.saturated || c->flags.slewed;
    ts_real speed = d->zdot_d < 0 ? -d->zdot_d : d->zdot_d;
    if (speed > c->fastest) c->fastest = speed < c->settings->velocity_limit ? speed : c->settings->velocity_limit;
    c->counters.commands++;
    c->counters.projected += c->flags.projected;
    c->counters.saturated += c->flags.saturated;
    c->counters.slewed += c->flags.slewed;
}

/* ---- The arrows of Fig. 5: adapt ------------------------------------------------------------------------------------- */

/* The regressor of the next tick that was not yet measured. */
static void next_lagged(ts_controller *c)
{
    const ts_settings *s = c->settings;
    int slot = (int)(c->lagged.ticks % TS_HISTORY);
    remember_creep(&c->lagged, s);
    remember_voltage(&c->lagged, s, c->x[slot]);
    regressor(s, &c->lagged, &c->motion[slot], c->u);
}

/* Whether a partial slope is outside its limits at the rate zdot_d or at -zdot_d. */
static bool outside(const ts_controller *c, ts_real zdot_d)
{
    const ts_settings *s = c->settings;
    const ts_real *w = c->w;
    ts_real rate = s->rate_scale * zdot_d, up = 0, down = 0;
    for (int i = 0; i < s->plays; i++) {
        ts_real a = *w++, b = s->rate_dependent[i] ? rate * *w++ : 0;
        up += a + b;
        down += a - b;
        if (up > s->slope_max || up < s->slope_min || down > s->slope_max || down < s->slope_min) return true;
    }
    return false;
}

/* The partial slope that is furthest outside its limits at the rate zdot_d, if any, is moved onto its limit. */
static void project_slope(ts_controller *c, ts_real zdot_d)
{
    const ts_settings *s = c->settings;
    ts_real rate = s->rate_scale * zdot_d, sum = 0, furthest = 0, onto = 0, g[TS_PADDED(TS_MAX_PARAMETERS)] = {0};
    int worst = -1, k = 0;
    for (int i = 0; i < s->plays; i++) {
        ts_real w_h = c->w[k++];
        if (s->rate_dependent[i]) w_h += rate * c->w[k++];
        sum += w_h;
        ts_real over = sum - s->slope_max, under = s->slope_min - sum, out = over > under ? over : under;
        if (out > furthest) {
            furthest = out;
            worst = i;
            onto = over > under ? s->slope_max : s->slope_min;
        }
    }
    if (worst < 0) return;
    for (int i = k = 0; i <= worst; i++) {
        g[k++] = 1;
        if (s->rate_dependent[i]) g[k++] = rate;
    }
    ts_kalman_project(&c->law.kalman, c->w, g, onto, c->parameters);
}

/* A frozen sensor: it repeats the same number while voltage and model move. A working one has noise, or a converter
 * whose steps are as large as that move: the smallest step so far, unless it is beyond a twentieth of the stroke. */
static bool frozen(ts_controller *c, ts_real z, ts_real predicted, bool stands)
{
    if (z != c->z_before || stands) {
        ts_real step = z > c->z_before ? z - c->z_before : c->z_before - z;
        bool first = c->lagged.ticks <= 1; /* there is none before it */
        if (!first && step > 0 && step < c->settings->stroke / 20 && !(c->resolution > 0 && c->resolution <= step))
            c->resolution = step;
        c->z_before = z;
        c->predicted_before = predicted;
        return false;
    }
    ts_real moved = predicted - c->predicted_before;
    ts_real noise = c->law.kalman.sigma + c->settings->kalman.model_error, still = 6 * noise;
    if (still < c->resolution + 2 * noise) still = c->resolution + 2 * noise;
    return moved > still || moved < -still;
}

/* Whether the error, behind the law's filter, moves more than noise does. Noise of variance 1 has a second difference of
 * variance 2 a^4 (4 - a) / (2 - a)^3 there. */
static bool rings(ts_controller *c, ts_real error)
{
    ts_ringing *r = &c->ringing;
    const ts_kalman *k = &c->law.kalman;
    ts_real a = k->filter, rest = 2 - a, rate = c->settings->oscillation.tick * RINGING_RATE, floor = c->settings->kalman.model_error;
    r->once += a * (error - r->once);
    ts_real twice = r->twice[0] + a * (r->once - r->twice[0]), d = twice - 2 * r->twice[0] + r->twice[1];
    r->twice[1] = r->twice[0];
    r->twice[0] = twice;
    ts_real noise = (k->sigma * k->sigma + floor * floor) * (2 * (a * a * a * a) * (4 - a) / (rest * rest * rest)), most = JUMP * noise;
    r->power += (rate < 1 ? rate : 1) * ((d * d < most ? d * d : most) - r->power);
    return r->power > RINGS * noise;
}

/* The regressor for the law: u itself, or, while the stage rings, that of the tick before, in `space`, with the measured
 * velocity and acceleration; *y is then what belongs to it. */
static const ts_real *with_inertia(ts_controller *c, const ts_real *u, ts_real *y, bool learn, ts_real *space)
{
    const ts_settings *s = c->settings;
    ts_ringing *r = &c->ringing;
    const ts_motion *d = &c->motion[(c->lagged.ticks - 1) % TS_HISTORY];
    ts_real T = s->oscillation.tick, shown = s->sensor.slow[0] * d->zdot_d + s->sensor.slow[1] * d->zddot_d;
    ts_real error = *y - (through_dead_zones(s, d->z_d) + d->ahead + shown);
    bool first = !r->started || !learn;
    r->started = learn;
    if (first) r->error[0] = r->error[1] = r->once = r->twice[0] = r->twice[1] = error;
    r->rings = rings(c, error) && !first;
    if (r->rings) {
        ts_real velocity = (error - r->error[1]) / (2 * T), change = (error - 2 * r->error[0] + r->error[1]) / (T * T), now = *y;
        int place = c->of_plays + s->terms[TS_CREEP];
        memcpy(space, r->u, sizeof r->u);
        if (s->terms[TS_LAG] > 0) space[place++] += within(velocity, -TS_LARGEST, TS_LARGEST);
        space[place] += within(change, -TS_LARGEST, TS_LARGEST);
        *y = r->y;
        r->y = now;
    } else r->y = *y;
    memcpy(r->u, u, sizeof r->u);
    r->error[1] = r->error[0];
    r->error[0] = error;
    return r->rings ? space : u;
}

/* One tick of the law: u.w should be y; innovation 0 and measured false where the measurement is missing or rejected. */
static void adapt_kalman(ts_controller *c, const ts_real *u, ts_real y, ts_real innovation, bool measured, bool learn)
{
    const ts_settings *s = c->settings;
    ts_kalman *k = &c->law.kalman;
    ts_real space[TS_PADDED(TS_MAX_PARAMETERS)];
    k->relates = dynamics_of(c)->known;
    if (measures_inertia(c)) u = with_inertia(c, u, &y, learn, space);
    if (!ts_kalman_tick(k, &s->kalman, s->initial_weights, prior_of(s), c->w, u, y, innovation, measured, learn, c->parameters)) return;
    if (outside(c, c->fastest)) { /* slopes are linear in the rate: its two ends are the worst */
        project_slope(c, c->fastest);
        project_slope(c, -c->fastest);
    }
    c->flags.changed = k->changed;
    c->counters.changed += k->changed;
}

/* ---- The stage -------------------------------------------------------------------------------------------------------- */

/* According to the model, so many ticks before the one that is measured next; at rest before the first one. um. */
static ts_real strain_of(const ts_controller *c, int back)
{
    uint64_t ticks = c->dynamics.ticks, before = (uint64_t)back;
    return c->dynamics.strain[(ticks > before ? ticks - before : 0) % TS_HISTORY];
}

/* The states of G after a long rest with this strain, um. */
static void rest_sections(ts_controller *c, ts_real strain)
{
    const ts_dynamics *g = dynamics_of(c);
    for (int i = 0; i < g->sections; i++) {
        const ts_real *q = g->section[i];
        ts_real *y = c->dynamics.section[i];
        y[0] = y[1] = (q[0] + q[1]) * strain / (1 + q[2] + q[3]);
    }
}

/* G: the measurement that the model expects of the next tick, um. At rest before the first one. */
static ts_real expected(ts_controller *c)
{
    const ts_dynamics *g = dynamics_of(c);
    ts_dynamics_state *d = &c->dynamics;
    ts_real u[4], z = 0; /* the strain `dead` ticks ago, and before that */
    for (int i = 0; i < 4; i++) u[i] = strain_of(c, g->dead + i);
    if (d->ticks == 0) rest_sections(c, u[0]);
    for (int i = 0; i < g->sections; i++) {
        const ts_real *q = g->section[i];
        ts_real *y = d->section[i];
        ts_real next = q[0] * u[0] + q[1] * u[1] - q[2] * y[0] - q[3] * y[1];
        y[1] = y[0];
        y[0] = next;
        z += next;
    }
    for (int i = 0; i < 3; i++) z += g->direct[i] * u[i];
    return z;
}

/* A: the measurement without the modes, um. */
static ts_real notched(ts_controller *c, ts_real z)
{
    const ts_dynamics *g = dynamics_of(c);
    ts_dynamics_state *d = &c->dynamics;
    if (d->ticks == 0) d->z[0] = d->z[1] = z; /* at rest before */
    ts_real y = g->notch[0] * z + g->notch[1] * d->z[0] + g->notch[2] * d->z[1];
    d->z[1] = d->z[0];
    d->z[0] = z;
    for (int i = 0; i < g->modes; i++) {
        const ts_real *q = g->mode[i];
        ts_real *x = d->mode[i];
        if (d->ticks == 0) {
            x[1] = (q[2] - q[4]) * y;
            x[0] = (q[1] - q[3]) * y + x[1];
        }
        ts_real in = y;
        y = q[0] * in + x[0];
        x[0] = q[1] * in - q[3] * y + x[1];
        x[1] = q[2] * in - q[4] * y;
    }
    return y;
}

/* The innovation without the first mode, as noisy as it was: ringing that the model knows is no noise. um. */
static ts_real quiet(const ts_controller *c, ts_real innovation)
{
    const ts_real *a = dynamics_of(c)->quiet, *before = c->dynamics.innovation;
    return a[0] * innovation + a[1] * before[0] + a[2] * before[1];
}

/* The states of A G after a long rest with the regressor of this tick. */
static void rest_stage(ts_controller *c)
{
    const ts_dynamics *g = dynamics_of(c);
    ts_dynamics_state *d = &c->dynamics;
    for (int i = 0; i < c->parameters; i += TS_LANES) {
        lanes x = load(c->u + i), s = zero();
        for (int k = TS_TAPS - 2; k >= 0; k--) {
            s = plus(s, g->tap[k + 1], x);
            store(d->tap[k] + i, s);
        }
        for (int k = 0; k < g->others; k++) {
            const ts_real *q = g->rest[k];
            lanes out = plus(zero(), (q[0] + q[1]) / (1 + q[2] + q[3]), x), older = plus(zero(), -q[3], out);
            store(d->rest[k][0] + i, plus(plus(older, q[1], x), -q[2], out));
            store(d->rest[k][1] + i, older);
        }
    }
}

/* y = sum of taps[i] q^-i x: each of the states t is a tick nearer to y than the next. */
static void pass_taps(const ts_real *taps, ts_real (*t)[TS_PADDED(TS_MAX_LEARNED)], const ts_real *x, ts_real *y, int m)
{
    ts_real tap[TS_TAPS]; /* which no store changes */
    memcpy(tap, taps, sizeof tap);
    for (int i = 0; i < m; i += TS_VECTOR) {
        ts_vector in = vector(x + i);
        *at(y + i) = *at(t[0] + i) + tap[0] * in;
        for (int k = 0; k < TS_TAPS - 2; k++) *at(t[k] + i) = *at(t[k + 1] + i) + tap[k + 1] * in;
        *at(t[TS_TAPS - 2] + i) = tap[TS_TAPS - 1] * in;
    }
}

/* y += (b0 + b1 q^-1) / (1 + a1 q^-1 + a2 q^-2) x, with the states t. */
static void pass_section(const ts_real *q, ts_real (*t)[TS_PADDED(TS_MAX_LEARNED)], const ts_real *x, ts_real *y, int m)
{
    ts_real b0 = q[0], b1 = q[1], a1 = q[2], a2 = q[3];
    for (int i = 0; i < m; i += TS_VECTOR) {
        ts_vector in = vector(x + i), out = *at(t[0] + i) + b0 * in;
        *at(t[0] + i) = *at(t[1] + i) + b1 * in - a1 * out;
        *at(t[1] + i) = -a2 * out;
        *at(y + i) += out;
    }
}

/* A G: the regressor as the measurement without the modes shows it, u; at rest before the first tick. */
static void pass_stage(ts_controller *c, ts_real *u)
{
    const ts_dynamics *g = dynamics_of(c);
    ts_dynamics_state *d = &c->dynamics;
    if (!d->started) rest_stage(c);
    d->started = true;
    pass_taps(g->tap, d->tap, c->u, u, TS_PADDED(c->parameters));
    for (int k = 0; k < g->others; k++) pass_section(g->rest[k], d->rest[k], c->u, u, TS_PADDED(c->parameters));
}

/* The regressor of the measured tick as the sensor shows it: u itself, or made in `space`. At rest before the first tick. */
static const ts_real *sensed(ts_controller *c, ts_real *space)
{
    const ts_sensor *s = &c->settings->sensor;
    ts_sensor_state *d = &c->sensor;
    if (!(s->share > 0) && !(s->lag > 0)) return c->u;
    bool first = c->lagged.ticks == 1;
    for (int i = 0; i < c->parameters; i += TS_LANES) {
        lanes u = load(c->u + i), before = first ? u : load(d->before + i), start = first ? u : load(d->lagged + i);
        lanes end = plus(plus(plus(zero(), s->pole, start), s->now, u), s->before, before);
        store(space + i, minus(plus(plus(zero(), 1 - s->share, u), s->share, before), s->lag, difference(end, start)));
        store(d->before + i, u);
        store(d->lagged + i, end);
    }
    return space;
}

/* Number of ticks whose measurement was used or passed over. */
static uint64_t measured_ticks(const ts_controller *c)
{
    return dynamics_of(c)->known ? c->dynamics.ticks : c->lagged.ticks;
}

static bool adapt_rls(ts_controller *c, const ts_real *u, bool learn)
{
    const ts_settings *s = c->settings;
    if (!learn) return true;
    bool used = ts_rls_update(&c->law.rls, c->w, u, c->innovation, s->forgetting, s->covariance_limit, c->parameters);
    if (!isfinite(c->law.rls.trace)) ts_rls_init(&c->law.rls, s->regularization, c->parameters);
    return used;
}

/* The regressor of the last command: u where that is the tick that was measured, or else made in `space`. */
static const ts_real *regressor_of_now(const ts_controller *c, ts_real *space)
{
    if (c->lagged.ticks == c->counters.commands) return c->u;
    regressor(c->settings, &c->now, &c->motion[last_slot(c)], space);
    for (int i = c->parameters; i < TS_PADDED(c->parameters); i++) space[i] = 0;
    return space;
}

/* The model's displacement for the regressor u, um. */
static ts_real model(const ts_controller *c, const ts_real *u)
{
    return dot(c->w, u, TS_PADDED(c->parameters));
}

/* At a voltage limit, and already beyond the desired displacement: the model is wrong there, not the limit. */
static bool beyond(const ts_controller *c, int slot, ts_real z)
{
    const ts_settings *s = c->settings;
    ts_real x = c->x[slot], z_d = c->motion[slot].z_d;
    return c->limited[slot] && ((x >= s->voltage_max && z > z_d) || (x <= s->voltage_min && z < z_d));
}

/* Whether a tick is used for adaptation. A limited one is, from the tenth on that was beyond without an unlimited one
 * between: otherwise weights that always demand more than the limit would never be corrected. */
static bool adapts(ts_controller *c, bool limited, bool beyond)
{
    if (!limited) c->beyond = 0;
    else if (beyond && c->beyond < TS_BEYOND) c->beyond++;
    return !c->hold && (!limited || (beyond && c->beyond >= TS_BEYOND));
}

/* Bumpless transfer: the command for the last tick stays as it was; the difference decays. */
static void keep_command(ts_controller *c)
{
    const ts_motion *last = &c->motion[last_slot(c)];
    (void)rate_dependent_slopes(c, last->zdot_d);
    if (c->counters.commands > 0) c->bumpless += sum_of_plays(c) - wanted_of_plays(c, last, of_known_terms(c, last));
}

/* ---- Self-excited oscillation of the stage ------------------------------------------------------------------------ */

/* The present weights are those to be restored; at the start there are no earlier ones. */
static void keep_weights(ts_controller *c, bool start)
{
    size_t size = sizeof(ts_real) * (size_t)c->parameters;
    memcpy(c->stage.older, start ? c->w : c->stage.newer, size);
    memcpy(c->stage.newer, c->w, size);
    c->stage.age = 0;
}

/* Quantities that follow from a measured resonance: the law's filter ends at half of it (at it where the inertia is learned),
 * and is no higher than `highest` unless that is far lower; a learned change takes a period of it to reach the command, which
 * includes the inertia. */
static void adopt_resonance(ts_controller *c, ts_real frequency, ts_real highest)
{
    const ts_settings *s = c->settings;
    ts_kalman *k = &c->law.kalman;
    bool learned = measures_inertia(c);
    ts_real w = (learned ? 2 * TS_PI : TS_PI) * frequency, pole = w / (1 + w), smoothing = 1 / (1 + frequency);
    if (pole > highest) pole = highest > pole / 8 ? highest : pole / 8;
    k->filter = pole < s->kalman.filter ? pole : s->kalman.filter;
    if (c->stage.smoothing < smoothing) c->stage.smoothing = smoothing;
    c->stage.resonance = frequency;
    ts_resonance_look(&c->resonance, frequency);
    c->stage.inertia = learned ? 0 : inertia_of(s, frequency);
    if (!learned) return;
    int place = c->of_plays + s->terms[TS_CREEP] + s->terms[TS_LAG];
    ts_real inertia = inertia_of(s, frequency) * s->oscillation.tick, deviation = FOUND * inertia;
    c->w[place] = -inertia;
    ts_kalman_separate(k, place, deviation * deviation, c->parameters);
    keep_command(c);
}

/* ---- The stage that was found ------------------------------------------------------------------------------------- */

/* The step response of a mode at the end of a tick: its integral, itself and its rate, per tick. By their series, each term from
 * the two before it: closed forms lose the digits of a slow mode, and ask for double arithmetic. */
static void step_of_mode(ts_real w, ts_real *integral, ts_real *step, ts_real *rate)
{
    ts_real drag = 2 * FOUND_DAMPING * w, stiff = w * w, before = 0, term = stiff / 6;
    *integral = term;
    *step = 3 * term;
    *rate = 6 * term;
    for (int n = 4; n <= STEP_TERMS; n++) {
        ts_real next = -(drag * term / (ts_real)n + stiff * before / (ts_real)(n * (n - 1)));
        before = term;
        term = next;
        *integral += term;
        *step += (ts_real)n * term;
        *rate += (ts_real)(n * (n - 1)) * term;
    }
}

/* The dynamics of one mode of this frequency, cycles per tick, behind so many ticks of dead time: the exact response to a command
 * that is held in each tick, as a mean over each tick. */
static void make_dynamics(ts_dynamics *g, ts_real frequency, ts_real tick, int dead)
{
    ts_real w = 2 * TS_PI * frequency, w0 = w / tick, integral, step, rate;
    step_of_mode(w, &integral, &step, &rate);
    ts_real drag = 2 * FOUND_DAMPING * w, pulse = rate / (w * w), kept = 1 - step - drag * pulse; /* of a velocity: its way, and itself */
    ts_real still = step * (step + drag * pulse) + pulse * rate, a1 = -(1 - step + kept), a2 = still - (1 + a1);
    ts_real from_rate = step / (w * w) * rate, from_place = 1 - integral;
    ts_real b0 = integral, b1 = integral * a1 + from_place * step + from_rate;
    ts_real b2 = integral * a2 - from_place * (kept * step - pulse * rate) - from_rate, direct = b2 / a2;
    ts_real n0 = 1 / still, n1 = a1 / still, n2 = a2 / still;
    ts_real d1 = n1 - 2 * n0, d2 = n2 - 2 * n1 + n0, d3 = n1 - 2 * n2; /* the second difference behind the notch */
    ts_real gain = root_of((n0 * n0 + d1 * d1 + d2 * d2 + d3 * d3 + n2 * n2) / 6);
    memset(g, 0, sizeof *g);
    g->known = true;
    g->sections = 1;
    g->dead = dead;
    const ts_real section[4] = {b0 - direct, b1 - direct * a1, a1, a2}, notch[3] = {n0, n1, n2}, tap[3] = {b0 / still, b1 / still, b2 / still};
    memcpy(g->section[0], section, sizeof section);
    memcpy(g->notch, notch, sizeof notch);
    memcpy(g->tap, tap, sizeof tap);
    for (int i = 0; i < 3; i++) g->quiet[i] = notch[i] / gain;
    g->direct[0] = direct;
    ts_real first, second, third, fourth;
    lead_of_dead_time(dead, &first, &second, &third, &fourth);
    g->lead[0] = 2 * FOUND_DAMPING / w0 + first * tick;
    g->lead[1] = 1 / (w0 * w0) + first * (2 * FOUND_DAMPING * tick / w0) + second * (tick * tick);
}

/* A weight is 0, independent of all others, with this variance. */
static void put_weight(ts_controller *c, int place, ts_real variance)
{
    c->w[place] = 0;
    ts_kalman_separate(&c->law.kalman, place, variance, c->parameters);
}

/* What was learned without the stage is wrong, and so is how sure it is. */
static void begin_anew(ts_controller *c)
{
    memcpy(c->w, c->kept.first, sizeof(ts_real) * (size_t)c->parameters);
    ts_kalman_reset_covariance(&c->law.kalman, prior_of(c->settings), c->parameters);
}

/* From now on the stage is between hysteresis and sensor; it rings by so much, um. Lag and inertia are in it, but for what it
 * misses, and so is what the rate weights have learned. */
static void adopt_stage(ts_controller *c, ts_real frequency, ts_real ringing)
{
    const ts_settings *s = c->settings;
    ts_kalman *k = &c->law.kalman;
    ts_dynamics_state *d = &c->dynamics;
    bool again = c->found.known;
    if (!dynamics_of(c)->known) d->ticks = c->lagged.ticks;
    make_dynamics(&c->found, frequency, s->oscillation.tick, s->dynamics.known ? s->dynamics.dead : 1);
    d->started = false;
    d->innovation[0] = d->innovation[1] = 0;
    for (int i = 0; i < 2; i++) /* it rings on */
        d->section[0][i] = d->z[i] - c->found.direct[0] * strain_of(c, c->found.dead + 1 + i);
    ts_real corner = 2 * TS_PI * FOUND_FILTER * frequency, time = s->oscillation.tick / (2 * TS_PI * frequency);
    k->filter = corner / (1 + corner);
    k->disturbance = k->caution = 0;
    c->stage.smoothing = s->smoothing;
    if (c->stage.smoothing < 1 / (1 + frequency)) c->stage.smoothing = 1 / (1 + frequency);
    c->stage.inertia = 0;
    int place = c->of_plays + s->terms[TS_CREEP];
    if (s->terms[TS_LAG] > 0) put_weight(c, place++, (FOUND_LAG * time) * (FOUND_LAG * time));
    if (s->terms[TS_INERTIA] > 0) put_weight(c, place, (FOUND_INERTIA * (time * time)) * (FOUND_INERTIA * (time * time)));
    for (int i = 0, at = 0; i < s->plays; i++, at++)
        if (s->rate_dependent[i]) {
            at++;
            put_weight(c, at, AS_GOOD_AS_NONE * s->prior[prior_entries(s, at + 1) - 1]);
        }
    k->started = false;
    keep_command(c);
    if (!again) {
        c->stage.trial = c->guard.kept; /* what was good before is good to go back to */
        c->kept.begun = c->kept.begun || !c->guard.kept;
        ts_guard_begin(&c->guard);
    }
    if (c->guard.ringing < ringing) c->guard.ringing = ringing;
}

/* The dynamics of the settings go on after another stage, as if they had rested where the last measurement is. */
static void return_to_given(ts_controller *c)
{
    const ts_dynamics *g = &c->settings->dynamics;
    ts_dynamics_state *d = &c->dynamics;
    rest_sections(c, strain_of(c, g->dead + 1));
    for (int i = 0; i < g->modes; i++) {
        const ts_real *q = g->mode[i];
        d->mode[i][1] = (q[2] - q[4]) * d->z[0];
        d->mode[i][0] = (q[1] - q[3]) * d->z[0] + d->mode[i][1];
    }
    d->innovation[0] = d->innovation[1] = 0;
    d->started = c->law.kalman.started = false;
}

/* The stage according to the settings. */
static void forget_stage(ts_controller *c)
{
    const ts_settings *s = c->settings;
    c->stage.smoothing = s->smoothing;
    if (s->law != TS_LAW_KALMAN) return;
    bool returns = c->found.known && s->dynamics.known;
    c->found.known = false;
    if (returns) return_to_given(c);
    c->stage.resonance = s->resonance;
    c->stage.inertia = inertia_of(s, s->resonance);
    c->law.kalman.filter = s->kalman.filter;
}

/* It was not that: the stage is that of the settings, or the resonance alone is known, as before. */
static void give_up_stage(ts_controller *c)
{
    if (!c->found.known) return;
    c->stage.trial = false;
    c->stage.failed = true;
    c->resonance.windows = 0;
    if (!c->settings->dynamics.known) {
        c->found.known = false;
        adopt_resonance(c, c->stage.resonance, 1);
        return;
    }
    forget_stage(c);
    keep_command(c);
}

/* ---- Self-excited oscillation, continued ---------------------------------------------------------------------------- */

/* The first time: earlier weights are restored, with the covariance of the prior. Then adaptation pauses, with a lower
 * filter, until the frequency of the ringing is measured. */
static void retreat(ts_controller *c, ts_real frequency)
{
    if (!c->oscillation.found) {
        memcpy(c->w, c->stage.older, sizeof(ts_real) * (size_t)c->parameters);
        keep_weights(c, true);
        ts_kalman_reset_covariance(&c->law.kalman, prior_of(c->settings), c->parameters);
    }
    adopt_resonance(c, frequency, c->oscillation.found ? LOWER * c->law.kalman.filter : 1);
    keep_command(c);
    c->stage.rest = 1 + REST_PERIODS / frequency;
    c->stage.since = c->counters.commands;
    c->oscillation.regular = 0;
    c->oscillation.found = true;
    c->counters.oscillating++;
}

/* Ringing at the resonance counts as noise: its variance after the filter, over the ticks of half a half-wave, times
 * four because it is not white. */
static void count_ringing(ts_controller *c)
{
    const ts_oscillation *o = &c->oscillation;
    ts_kalman *k = &c->law.kalman;
    ts_real f = c->stage.resonance;
    if (!(f > 0) || o->length != 0) return; /* once in a half-wave */
    ts_real ratio = o->regular >= 2 ? ts_oscillation_frequency(o, 2) / f : 0;
    if (ratio < (ts_real)0.7 || ratio > (ts_real)1.4) {
        k->disturbance /= 2;
        return;
    }
    ts_real w = 2 * TS_PI * f * (1 - k->filter) / k->filter, left = o->peaks[0] / (1 + w * w);
    k->disturbance = left * left / (2 * f);
}

/* Standard deviation of a measurement, um: as it is now, and no less than the sensor's steps. */
static ts_real noise_of(const ts_controller *c)
{
    const ts_kalman *k = &c->law.kalman;
    ts_real variance = k->sigma * k->sigma;
    if (variance < (ts_real)0.5 * k->ringing) variance = (ts_real)0.5 * k->ringing;
    ts_real noise = root_of(variance);
    return noise < c->resolution ? c->resolution : noise;
}

/* The frequency of the ringing is measured, in cycles per tick: then the stage is known, but where that failed before, the sensor
 * is late, or its measurements are older than the strains that were kept. */
static void know_resonance(ts_controller *c, ts_real frequency)
{
    const ts_sensor *s = &c->settings->sensor;
    adopt_resonance(c, frequency, c->counters.oscillating > 1 ? c->law.kalman.filter : 1);
    bool late = s->ticks > 0 || s->share > 0 || s->lag > 0;
    if (c->stage.failed || late || c->lagged.ticks < c->stage.since + 4) return;
    if (!c->guard.kept) begin_anew(c);
    adopt_stage(c, frequency, c->oscillation.peaks[0]);
}

/* Whether weights are held and the stage rings on by itself, faster than the motion: it decays, and shows its resonance. */
static bool rings_freely(const ts_controller *c)
{
    const ts_oscillation *o = &c->oscillation;
    const ts_sensor *late = &c->settings->sensor;
    if (c->guard.held == 0 || c->stage.failed || o->length != 0 || o->regular < FREE || c->lagged.ticks < 8) return false;
    if (c->settings->resonance > 0 || late->ticks > 0 || late->share > 0 || late->lag > 0) return false;
    if (!(o->peaks[0] < DECAYED * o->peaks[FREE - 1])) return false;
    ts_real omega = 2 * TS_PI * ts_oscillation_frequency(o, FREE);
    return o->peaks[0] > c->settings->oscillation.floor && omega * o->speed >= (ts_real)2.5 * o->acceleration;
}

/* One tick of the detection of a self-excited oscillation, and the reaction to it. */
static void watch_stage(ts_controller *c, ts_real error, ts_real zdot_d, bool limited)
{
    const ts_settings *s = c->settings;
    ts_oscillation *o = &c->oscillation;
    ts_real found = ts_oscillation_tick(o, &s->oscillation, error, zdot_d, noise_of(c));
    if (limited) o->sign = o->regular = 0; /* the law does not cause the error at a limit */
    count_ringing(c);
    if (rings_freely(c)) {
        c->stage.resonance = ts_oscillation_frequency(o, FREE);
        c->stage.rest = 0;
        c->flags.oscillating = false;
        ts_resonance_look(&c->resonance, c->stage.resonance);
        begin_anew(c);
        adopt_stage(c, c->stage.resonance, o->peaks[0]);
        return;
    }
    if (c->stage.rest > 0) {
        c->stage.rest = o->regular >= REST_HALF_WAVES || c->stage.rest < 1 ? 0 : c->stage.rest - 1;
        if (!(c->stage.rest > 0) && o->regular >= 4)
            know_resonance(c, ts_oscillation_frequency(o, o->regular < 6 ? 4 : 6));
    } else if (found > 0 && c->guard.held == 0 && !(o->found && measures_inertia(c)) && !limited && found > NOT_BELOW * c->stage.resonance && !c->hold) {
        retreat(c, found);
    } else {
        c->stage.age += s->oscillation.tick;
        if (c->stage.age > (ts_real)TS_KEEP && o->regular < 3) keep_weights(c, false);
    }
    c->flags.oscillating = c->stage.rest > 0;
}

/* ---- Never worse than not learning -------------------------------------------------------------------------------- */

static void weights_at_best(ts_controller *c)
{
    memcpy(c->kept.w, c->w, sizeof(ts_real) * (size_t)c->parameters);
    for (int i = 0; i < c->parameters; i++)
        memcpy(c->kept.P + TS_PACKED(i), c->law.kalman.P + TS_ROW(i), sizeof(ts_real) * (size_t)(i + 1));
    c->kept.sigma = c->law.kalman.sigma;
    c->kept.filter = c->law.kalman.filter;
    c->kept.smoothing = c->stage.smoothing;
    c->kept.resonance = c->stage.resonance;
    c->kept.inertia = c->stage.inertia;
    c->kept.oscillated = c->oscillation.found;
    c->kept.failed = c->stage.failed;
    c->kept.staged = dynamics_of(c)->known;
    c->kept.begun = false;
}

/* Until there are better ones, the first weights are the best. */
static void keep_start(ts_controller *c)
{
    if (c->settings->law != TS_LAW_KALMAN) return;
    keep_weights(c, true);
    memcpy(c->kept.first, c->w, sizeof(ts_real) * (size_t)c->parameters);
    memcpy(c->kept.w, c->w, sizeof(ts_real) * (size_t)c->parameters);
    c->guard.wait = TS_FIRST_WAIT;
}

static void move_offset(ts_controller *c, ts_real by)
{
    if (!c->settings->terms[TS_OFFSET]) return;
    ts_real *offset = &c->w[column(c->settings, TS_OFFSET)];
    *offset = within(*offset + by, -TS_LARGEST, TS_LARGEST);
}

/* The command goes on from where it is with other weights; earlier ones miss what has drifted since. The feedback waits, for
 * its margins are those of a model that has been learned. */
static void take_weights(ts_controller *c, const ts_real *w, bool earlier)
{
    const ts_kalman *k = &c->law.kalman;
    memcpy(c->w, w, sizeof(ts_real) * (size_t)c->parameters);
    if (earlier && k->started) move_offset(c, k->y - model(c, k->u));
    keep_command(c);
    c->feedback.alarms = 2 * PAUSE;
}

/* What was held is better: its covariance, and an error as large as the one that failed counts as noise for a while. */
static void learn_cautiously(ts_controller *c)
{
    ts_kalman *k = &c->law.kalman;
    const ts_guard *g = &c->guard;
    ts_kalman_reset_covariance(k, g->kept ? (ts_prior){c->kept.P, NULL} : prior_of(c->settings), c->parameters);
    if (g->kept) k->sigma = c->kept.sigma;
    ts_real range = ts_guard_range(g, &c->settings->guard), error = (g->failed < MOST_CAUTION ? g->failed : MOST_CAUTION) * range;
    k->caution = error * error * (ts_real)c->settings->guard.window / 4;
}

/* Whether the stage of the model is the one that the measurements show. Where it is near, it is moved there. */
static bool stage_is_shown(ts_controller *c)
{
    const ts_resonance *r = &c->resonance;
    if (!c->found.known || !(r->known > 0) || r->variance > CERTAIN * CERTAIN) return false;
    ts_real moved = r->known / c->stage.resonance - 1;
    if (moved * moved > FURTHER * FURTHER) return false;
    if (moved * moved > MOVED * MOVED) {
        c->stage.resonance = r->known;
        adopt_stage(c, r->known, 0);
    }
    return true;
}

/* After a window with this error over the range: whether the dynamics of the settings leave an error that is large and does not fall. */
static void doubt_dynamics(ts_controller *c, ts_real error)
{
    if (error > DOUBT && c->stage.doubted > 0 && error > FALLEN * c->stage.doubt) {
        if (c->stage.doubted < LASTS) c->stage.doubted++;
        return;
    }
    c->stage.doubt = error;
    c->stage.doubted = error > DOUBT;
}

static void watch_learning(ts_controller *c, ts_real error, ts_real z_d, bool counts)
{
    const ts_settings *s = c->settings;
    ts_guard *g = &c->guard;
    ts_kalman *k = &c->law.kalman;
    if (s->guard.window == 0 || c->hold) return;
    bool resting = c->stage.rest > 0 && g->held == 0;
    ts_real noise = g->kept ? c->kept.sigma : k->sigma;
    if (noise < c->resolution) noise = c->resolution;
    switch (ts_guard_tick(g, &s->guard, error, z_d, counts && !resting, noise)) {
    case TS_GUARD_KEEP:
        weights_at_best(c);
        c->stage.trial = false;
        break;
    case TS_GUARD_RESTORE:
        memcpy(c->kept.aside, c->w, sizeof(ts_real) * (size_t)c->parameters);
        if (c->stage.trial) give_up_stage(c);
        take_weights(c, c->kept.begun ? c->kept.first : c->kept.w, true);
        c->counters.restored++;
        break;
    case TS_GUARD_FIRST:
        if (!stage_is_shown(c)) give_up_stage(c);
        take_weights(c, c->kept.first, true);
        break;
    case TS_GUARD_ADOPT: learn_cautiously(c); break;
    case TS_GUARD_RETURN:
        if (c->found.known && !stage_is_shown(c)) {
            give_up_stage(c);
            take_weights(c, c->kept.first, true);
            ts_kalman_reset_covariance(k, prior_of(s), c->parameters);
        } else {
            bool of_motion = c->stage.resonance < ts_resonance_lowest(&c->resonance, s->oscillation.tick);
            if (of_motion && !(s->resonance > 0 || dynamics_of(c)->known)) { /* it was no resonance */
                forget_stage(c);
                c->oscillation.found = false;
            }
            take_weights(c, c->kept.aside, false);
        }
        break;
    case TS_GUARD_NOTHING:
    default: break;
    }
    if (g->ticks == 0 && is_given(c)) doubt_dynamics(c, g->error);
    if (g->held > 0 || k->caution > CAUTIOUS * (k->sigma * k->sigma)) move_offset(c, g->drift);
    if (g->held == 0 && g->ticks == 0) k->caution *= 1 - (ts_real)0.8 / (ts_real)g->wait;
    c->flags.restored = g->held > 0;
}

/* The kept weights again, moved by this offset, um, and what was known of the stage with them. */
static void recall(ts_controller *c, ts_real offset)
{
    ts_kalman *k = &c->law.kalman;
    ts_resonance *r = &c->resonance;
    c->found.known = c->stage.trial = false;
    c->stage.failed = c->kept.failed;
    c->stage.resonance = c->kept.resonance;
    c->stage.inertia = c->kept.inertia;
    c->stage.smoothing = c->kept.smoothing;
    c->stage.rest = 0;
    c->oscillation.found = c->kept.oscillated;
    c->oscillation.sign = c->oscillation.regular = 0;
    r->known = r->variance = 0;
    r->windows = r->ticks = 0;
    ts_kalman_reset_covariance(k, (ts_prior){c->kept.P, NULL}, c->parameters);
    k->sigma = c->kept.sigma;
    k->filter = c->kept.filter;
    k->disturbance = k->caution = 0;
    take_weights(c, c->kept.w, false);
    move_offset(c, offset);
    keep_weights(c, true);
    keep_command(c);
    ts_guard_recall(&c->guard);
    c->counters.restored++;
    c->flags.oscillating = false;
    c->flags.restored = true; /* in this tick */
}

/* While the model is lost: whether the kept weights predict the measurements again, without a stage that was found since. z belongs
 * to the regressor u. */
static void watch_kept(ts_controller *c, const ts_real *u, ts_real z)
{
    const ts_settings *s = c->settings;
    const ts_guard *g = &c->guard;
    if (!g->lost || c->kept.staged || c->hold || c->lagged.ticks < 2) {
        c->kept.recall.ticks = 0;
        return;
    }
    ts_real change = c->motion[(c->lagged.ticks - 1) % TS_HISTORY].zdot_d - c->motion[(c->lagged.ticks - 2) % TS_HISTORY].zdot_d;
    ts_real predicted = dot(c->kept.w, u, TS_PADDED(c->parameters)), offset = 0;
    ts_real missed = through_dead_zones(s, z) + c->kept.inertia * change - predicted;
    ts_real noise = c->kept.sigma > c->resolution ? c->kept.sigma : c->resolution;
    if (ts_recall_tick(&c->kept.recall, &s->guard, predicted, missed, ts_guard_range(g, &s->guard), noise, &offset)) recall(c, offset);
}

/* ---- The resonance from what is measured anyway ------------------------------------------------------------------- */

/* Whether the stage is put into the model, or its resonance there replaced: the motion is fast enough that it matters, and the error
 * larger than noise. */
static bool matters(const ts_controller *c)
{
    const ts_sensor *s = &c->settings->sensor;
    const ts_resonance *r = &c->resonance;
    if (c->settings->resonance > 0 || c->hold || c->stage.rest > 0) return false;
    if (s->ticks > 0 || s->share > 0 || s->lag > 0 || c->lagged.ticks < 8) return false;
    if (r->windows < 2 || r->variance > CERTAIN * CERTAIN) return false;
    if (c->found.known) {
        ts_real moved = r->known / c->stage.resonance - 1;
        return moved * moved > MOVED * MOVED && moved * moved < FURTHER * FURTHER && moved * moved > 4 * r->variance;
    }
    if (is_given(c)) {
        const ts_guard *g = &c->guard;
        bool failing = g->held > 0 || g->wait > TS_FIRST_WAIT;
        ts_real away = r->known / c->settings->dynamics.first - 1, least = failing ? ELSEWHERE : ANOTHER;
        ts_real large = DOUBT * ts_guard_range(g, &c->settings->guard);
        if (!failing && c->stage.doubted < LASTS) return false;
        return away * away > least * least && r->power > large * large && r->driven > DRIVEN;
    }
    ts_real noise = noise_of(c);
    return r->motion > SLOWEST * r->known && r->power > NOISY * noise * noise;
}

/* One tick of the estimate: the plays of a tick before the measurement, which is about its dead time. */
static void watch_resonance(ts_controller *c, ts_real z, ts_real error, const ts_motion *d, bool staged)
{
    const ts_settings *s = c->settings;
    ts_resonance *r = &c->resonance;
    ts_real x[TS_SHOWN + 1], now[TS_SHOWN];
    if (is_given(c) && !(c->guard.error > DOUBT)) { /* no reason to look for another */
        r->ticks = 0;
        return;
    }
    for (int i = 0; i < TS_SHOWN; i++) now[i] = c->lagged.play[(i * (s->plays - 1) + (TS_SHOWN - 1) / 2) / (TS_SHOWN - 1)];
    memcpy(x, staged ? now : c->shown, sizeof now);
    memcpy(c->shown, now, sizeof now);
    x[TS_SHOWN] = z;
    bool known = ts_resonance_tick(r, s->oscillation.tick, x, error, d->zdot_d, d->zdot_d - c->rate);
    c->rate = d->zdot_d;
    if (!known || !matters(c)) return;
    c->stage.resonance = r->known;
    c->guard.settled = c->guard.settled && c->guard.lost; /* else it was no wrong sensor: there is nothing to return to */
    if (!c->found.known) begin_anew(c);
    adopt_stage(c, r->known, root_of(r->power));
}

/* ---- A tick of the measured side -------------------------------------------------------------------------------------- */

/* Commands that may wait for their measurement. */
static int waiting(const ts_controller *c)
{
    const ts_dynamics *g = dynamics_of(c);
    return TS_HISTORY - (g->known ? g->dead + 4 : 0);
}

/* The same, while the measurements come as late as the last one: a gap in them is passed over tick by tick, so that the first one
 * after it does not take long. */
static int patience(const ts_controller *c)
{
    int most = waiting(c), gap = c->answered + TS_BACKLOG - 1;
    return c->answered > 0 && gap < most ? gap : most;
}

/* One tick of the stage with the measurement z, or what was expected in its place: it shows the tick `dead` before. */
static void learn_staged(ts_controller *c, ts_real z, ts_real innovation, bool measured, bool learn)
{
    ts_real u[TS_PADDED(TS_MAX_PARAMETERS)], y = notched(c, z), noisy = quiet(c, innovation);
    c->dynamics.innovation[1] = c->dynamics.innovation[0];
    c->dynamics.innovation[0] = innovation;
    c->dynamics.ticks++;
    if (c->dynamics.ticks <= c->lagged.ticks + (uint64_t)dynamics_of(c)->dead) return;
    next_lagged(c);
    pass_stage(c, u);
    /* One notched sample is noise, thousands of times that of z where f0 is far below the sample rate: the filters must not
     * start from it. */
    if (learn) ts_kalman_start_filters(&c->law.kalman, c->parameters);
    adapt_kalman(c, u, y, noisy, measured, learn);
}

/* Whether the feedback waits: from the rate of alarms PAUSE on, until it is below RESUME. The margins are those of a model
 * that has been learned. */
static bool pauses(ts_controller *c)
{
    ts_feedback_state *b = &c->feedback;
    ts_real tick = c->settings->oscillation.tick, share = tick / (ts_real)ALARMS;
    b->alarms += (share < 1 ? share : 1) * ((c->flags.changed ? 1 / tick : 0) - b->alarms);
    b->paused = b->alarms > (b->paused ? (ts_real)RESUME : (ts_real)PAUSE);
    return b->paused;
}

/* One tick of the feedback, for the command after it. */
static void feed_back(ts_controller *c, ts_real error)
{
    const ts_feedback *f = &c->settings->feedback;
    if (f->filters && (c->found.known || (c->settings->oscillation.tick > 0 && pauses(c)))) { /* its margins are those of the stage */
        memset(c->feedback.state, 0, sizeof c->feedback.state);
        c->feedback.sum = 0;
        return;
    }
    ts_real sum = 0;
    for (int i = 0; i < f->filters; i++) {
        const ts_real *q = f->filter[i];
        ts_real *x = c->feedback.state[i], y = q[0] * error + x[0];
        x[0] = q[1] * error - q[3] * y + x[1];
        x[1] = q[2] * error - q[4] * y;
        sum += y;
    }
    c->feedback.sum = within(sum, -f->most, f->most);
}

/* A tick for which no measurement came. */
static void pass_over(ts_controller *c)
{
    const ts_settings *s = c->settings;
    c->resonance.ticks = 0; /* its window begins anew */
    bool learn = !c->limited[c->lagged.ticks % TS_HISTORY];
    if (dynamics_of(c)->known) {
        learn_staged(c, expected(c), 0, false, learn);
    } else {
        ts_real space[TS_PADDED(TS_MAX_PARAMETERS)];
        next_lagged(c);
        const ts_real *u = sensed(c, space);
        if (s->law == TS_LAW_KALMAN) adapt_kalman(c, u, model(c, u), 0, false, learn);
    }
    if (s->law == TS_LAW_KALMAN) ts_oscillation_miss(&c->oscillation, &s->oscillation, NULL);
    feed_back(c, 0);
}

/* Adapts to z; u: the regressor as the sensor shows it, where the stage is not known; `back`: at a voltage limit and beyond
 * the desired displacement. Returns whether z was used. */
static bool learn_from(ts_controller *c, const ts_real *u, ts_real z, const ts_motion *d, bool limited, bool back, bool stands)
{
    const ts_settings *s = c->settings;
    ts_kalman *k = &c->law.kalman;
    bool staged = dynamics_of(c)->known;
    ts_real predicted = staged ? expected(c) : model(c, u);
    c->innovation = staged ? z - predicted : through_dead_zones(s, z) + d->ahead - predicted; /* (15) */
    if (s->law == TS_LAW_RLS) return adapt_rls(c, u, !c->hold);
    ts_real noisy = staged ? quiet(c, c->innovation) : c->innovation;
    bool used = !frozen(c, z, predicted, stands), smooth = staged || c->ringing.rings;
    bool spike = used && ts_kalman_is_spike(k, &s->kalman, c->innovation, noisy, smooth);
    ts_real innovation = used && !spike ? c->innovation : 0;
    bool learn = adapts(c, limited, back) && !(c->stage.rest > 0) && c->guard.held == 0;
    used = used && !spike;
    if (staged) learn_staged(c, used ? z : predicted, innovation, used, learn);
    else adapt_kalman(c, u, predicted + innovation, innovation, used, learn);
    return used;
}

/* One tick with its measurement z; returns whether it was used. */
static bool measure(ts_controller *c, ts_real z)
{
    const ts_settings *s = c->settings;
    bool staged = dynamics_of(c)->known, smooth = c->stage.smoothing > 0;
    uint64_t tick = measured_ticks(c);
    int slot = (int)(tick % TS_HISTORY);
    bool limited = c->limited[slot], learned = c->limited[c->lagged.ticks % TS_HISTORY], back = beyond(c, slot, z);
    bool stands = c->x[slot] == (staged && tick > 0 ? c->x[(tick - 1) % TS_HISTORY] : c->lagged.play[0]);
    const ts_motion *d = &c->motion[slot];
    ts_real space[TS_PADDED(TS_MAX_PARAMETERS)], shown[TS_PADDED(TS_MAX_PARAMETERS)], before = 0;
    const ts_real *now = NULL, *u = NULL;
    if (!staged) {
        next_lagged(c);
        u = sensed(c, shown);
    }
    if (smooth) {
        now = regressor_of_now(c, space);
        before = model(c, now);
    }
    bool used = learn_from(c, u, z, d, learned, back, stands);
    /* A learned change reaches the command gradually, so that it does not excite the stage. */
    if (used && smooth) c->bumpless += c->stage.smoothing * (model(c, now) - before);
    const ts_real *slow = staged ? dynamics_of(c)->sensor : s->sensor.slow;
    ts_real error = z - (d->z_d + slow[0] * d->zdot_d + slow[1] * d->zddot_d);
    /* The trim: at a voltage limit only away from it; the slew limit only delays. */
    if (used && (!limited || back)) c->integral -= s->trim * error;
    feed_back(c, used && (!limited || back) ? -error : 0); /* no wind-up at a limit */
    if (used && !staged && s->law == TS_LAW_KALMAN) {
        c->dynamics.z[1] = c->dynamics.z[0];
        c->dynamics.z[0] = z;
    }
    if (!used) ts_oscillation_miss(&c->oscillation, &s->oscillation, &error);
    else if (s->law == TS_LAW_KALMAN && s->oscillation.tick > 0 && !staged) watch_stage(c, error, d->zdot_d, limited);
    if (s->law == TS_LAW_KALMAN && s->oscillation.tick > 0) watch_resonance(c, z, error, d, staged);
    bool at_limit = c->x[slot] >= s->voltage_max || c->x[slot] <= s->voltage_min;
    if (s->law == TS_LAW_KALMAN) {
        watch_learning(c, error, d->z_d, used && (!at_limit || back));
        if (staged && c->dynamics.ticks != c->lagged.ticks + 1) c->kept.recall.ticks = 0; /* u is not that of the measurement before */
        else if (used) watch_kept(c, staged ? c->u : u, staged ? c->dynamics.z[1] : z);
    }
    return used;
}

/* ---- Public -------------------------------------------------------------------------------------------------------- */

ts_status ts_controller_init(ts_controller *c, const ts_settings *settings)
{
    ts_status status = check(settings);
    if (status != TS_OK) return status;
    c->settings = settings;
    c->parameters = ts_parameters(settings);
    c->of_plays = column(settings, TS_CREEP);
    ts_controller_reset(c);
    return TS_OK;
}

static void start_law(ts_controller *c)
{
    const ts_settings *s = c->settings;
    if (s->law == TS_LAW_RLS) {
        ts_rls_init(&c->law.rls, s->regularization, c->parameters);
        return;
    }
    ts_kalman_init(&c->law.kalman, prior_of(s), s->first_noise, c->parameters);
    for (int i = 0, k = 0; i < s->plays && k < TS_MAX_LEARNED; i++) { /* gcc does not know that k is below */
        c->law.kalman.part[k] = i ? 2 : 1;
        k += s->rate_dependent[i] ? 2 : 1;
    }
}

void ts_controller_reset(ts_controller *c)
{
    size_t after = offsetof(ts_controller, w);
    memset((char *)c + after, 0, sizeof *c - after);
    memcpy(c->w, c->settings->initial_weights, sizeof(ts_real) * (size_t)c->parameters);
    start_law(c);
    forget_stage(c);
    c->feedback.alarms = AT_FIRST; /* nothing is learned yet */
    c->feedback.paused = true;
    keep_start(c);
    (void)rate_dependent_slopes(c, 0);
}

ts_real ts_reach(const ts_settings *s, ts_real volts)
{
    ts_real share = (volts < 0 ? -volts : volts) / (s->voltage_max - s->voltage_min);
    ts_real reach = 3 * s->stroke * (1 + share);
    return reach < s->measurement_limit ? reach : s->measurement_limit;
}

ts_status ts_controller_start(ts_controller *c, ts_real volts, ts_real z)
{
    const ts_settings *s = c->settings;
    if (!isfinite(volts) || !isfinite(z)) return TS_NOT_FINITE;
    if (volts < s->voltage_min || volts > s->voltage_max) return TS_BAD_VOLTAGE;
    if (!(z >= -ts_reach(s, volts) && z <= ts_reach(s, volts))) return TS_BEYOND_REACH;
    ts_controller_reset(c);
    ts_play_bank(volts, s->thresholds, c->now.play, s->plays);
    for (int i = 0; i < s->terms[TS_CREEP]; i++) c->now.creep[i] = volts;
    c->lagged = c->now;
    const ts_motion still = {.z_d = z};
    ts_real missing = wanted_of_plays(c, &still, of_known_terms(c, &still)) - sum_of_plays(c);
    if (s->terms[TS_OFFSET] > 0) c->w[column(s, TS_OFFSET)] += missing; /* a constant until there are data */
    else c->bumpless = -missing;
    keep_start(c);
    return TS_OK;
}

static bool equal(const ts_real *a, const ts_real *b, int n)
{
    bool same = true;
    for (int i = 0; i < n; i++) same = same && !(a[i] < b[i] || a[i] > b[i]);
    return same;
}

static bool same_dynamics(const ts_dynamics *a, const ts_dynamics *b)
{
    bool same = a->known == b->known && equal(&a->first, &b->first, 1) && a->sections == b->sections && a->dead == b->dead && a->others == b->others
                && a->modes == b->modes;
    return same && equal(&a->mode[0][0], &b->mode[0][0], 5 * TS_SECTIONS) && equal(&a->section[0][0], &b->section[0][0], 4 * TS_SECTIONS) && equal(a->direct, b->direct, 3)
           && equal(a->notch, b->notch, 3) && equal(a->quiet, b->quiet, 3) && equal(a->tap, b->tap, TS_TAPS) && equal(&a->rest[0][0], &b->rest[0][0], 4 * TS_SECTIONS)
           && equal(a->lead, b->lead, 2) && equal(a->sensor, b->sensor, 2);
}

static bool same_prior(const ts_settings *a, const ts_settings *b)
{
    int m = ts_parameters(a);
    return memcmp(a->prior_from, b->prior_from, (size_t)m) == 0 && equal(a->prior, b->prior, prior_entries(a, m));
}

/* What a law has learned belongs to its terms, thresholds, times and prior. */
static bool same_model(const ts_settings *a, const ts_settings *b)
{
    bool same = a->law == b->law && a->plays == b->plays && a->dead_zones == b->dead_zones;
    for (int i = 0; i < TS_TERMS; i++) same = same && a->terms[i] == b->terms[i];
    for (int i = 0; same && i < a->plays; i++) same = a->rate_dependent[i] == b->rate_dependent[i];
    int m = same ? ts_parameters(a) : 0;
    return same && equal(a->thresholds, b->thresholds, a->plays) && equal(a->creep, b->creep, a->terms[TS_CREEP])
           && equal(a->dead_zone_thresholds, b->dead_zone_thresholds, a->dead_zones) && equal(&a->stroke, &b->stroke, 1)
           && equal(a->initial_weights, b->initial_weights, m) && equal(&a->regularization, &b->regularization, 1)
           && equal(&a->oscillation.tick, &b->oscillation.tick, 1) && same_dynamics(&a->dynamics, &b->dynamics)
           && a->sensor.ticks == b->sensor.ticks && equal(&a->sensor.share, &b->sensor.share, 1) && equal(&a->sensor.lag, &b->sensor.lag, 1)
           && (a->law != TS_LAW_KALMAN || same_prior(a, b));
}

static bool same_stage(const ts_settings *a, const ts_settings *b)
{
    return equal(&a->kalman.filter, &b->kalman.filter, 1) && equal(&a->smoothing, &b->smoothing, 1)
           && equal(&a->resonance, &b->resonance, 1);
}

ts_status ts_controller_change(ts_controller *c, const ts_settings *next)
{
    const ts_settings *s = c->settings;
    ts_status status = check(next);
    if (status != TS_OK) return status;
    if (!same_model(s, next)) return TS_BAD_TERMS;
    bool as_it_was = same_stage(s, next);
    c->settings = next;
    if (!as_it_was) forget_stage(c);
    if (!(next->trim > 0)) c->integral = 0; /* its share goes into the bumpless transfer */
    keep_command(c);
    return TS_OK;
}

ts_status ts_controller_command(ts_controller *c, ts_real z_d, ts_real zdot_d, ts_real *volts)
{
    return ts_controller_follow(c, z_d, zdot_d, (ts_real)NAN, (ts_real)NAN, NULL, volts);
}

/* Whether they are finite; if so within TS_LARGEST. */
static bool take_others(ts_motion *d, const ts_real *others, int axes)
{
    bool good = true;
    for (int i = 0; others && i < 3 * axes; i++) {
        good = good && isfinite(others[i]);
        d->others[i / 3][i % 3] = within(others[i], -TS_LARGEST, TS_LARGEST);
    }
    return good;
}

ts_status ts_controller_follow(ts_controller *c, ts_real z_d, ts_real zdot_d, ts_real zddot_d, ts_real strain_d,
                               const ts_real *others, ts_real *volts)
{
    const ts_settings *s = c->settings;
    ts_motion d = {0};
    if (!isfinite(z_d) || !isfinite(zdot_d) || isinf(zddot_d) || isinf(strain_d)) return TS_NOT_FINITE;
    if (!take_others(&d, others, s->terms[TS_COUPLING])) return TS_NOT_FINITE;
    bool known_acceleration = zddot_d == zddot_d, known_strain = strain_d == strain_d && !c->found.known;
    z_d = within(z_d, -TS_LARGEST, TS_LARGEST);
    zdot_d = within(zdot_d, -TS_LARGEST, TS_LARGEST);
    zddot_d = within(zddot_d, -TS_LARGEST, TS_LARGEST);
    if (c->counters.commands - measured_ticks(c) >= (uint64_t)patience(c))
        pass_over(c); /* before its slot is taken */
    remember_creep(&c->now, s);
    d.z_d = z_d;
    d.zdot_d = zdot_d;
    d.zddot_d = known_acceleration ? zddot_d : acceleration(c, zdot_d);
    d.ahead = known_strain ? within(strain_d, -TS_LARGEST, TS_LARGEST) - z_d : ahead_of(c, zdot_d, d.zddot_d);
    ts_real known = of_known_terms(c, &d);
    c->y_d = wanted_of_plays(c, &d, known);
    c->flags.projected = rate_dependent_slopes(c, zdot_d);
    *volts = within_limits(c, ts_play_inverse(c->y_d, c->slopes, s->thresholds, c->now.play, s->plays));
    remember_voltage(&c->now, s, *volts);
    c->bumpless *= c->stage.smoothing;
    write_down(c, *volts, &d, known);
    return TS_OK;
}

ts_status ts_controller_adapt(ts_controller *c, ts_real z, int ago)
{
    const ts_settings *s = c->settings;
    uint64_t commands = c->counters.commands;
    bool given = ago >= 0 && ago < TS_HISTORY && (uint64_t)ago < commands;
    if (given) {
        ago += s->sensor.ticks;
        c->answered = ago + 1;
    }
    if (given && (uint64_t)ago >= commands) { /* it shows what was before the first command */
        c->flags.changed = c->flags.rejected = false;
        return TS_OK;
    }
    bool in_time = ago >= 0 && ago < waiting(c) && (uint64_t)ago < commands && commands - (uint64_t)ago > measured_ticks(c);
    if (in_time && measured_ticks(c) == 0 && isfinite(z)) { /* the first one */
        ts_real reach = ts_reach(s, c->x[(commands - 1 - (uint64_t)ago) % TS_HISTORY]);
        if (z < -reach || z > reach) return TS_BEYOND_REACH;
    }
    bool used = in_time && z >= -s->measurement_limit && z <= s->measurement_limit;
    c->flags.changed = false;
    if (used) {
        while (measured_ticks(c) < commands - 1 - (uint64_t)ago) pass_over(c);
        used = measure(c, z);
    }
    c->flags.rejected = !used;
    c->counters.rejected += !used;
    c->counters.adaptations += used && !c->hold;
    return used ? TS_OK : TS_REJECTED;
}

void ts_controller_hold(ts_controller *c, bool hold)
{
    c->hold = hold;
    c->flags.held = hold;
}
