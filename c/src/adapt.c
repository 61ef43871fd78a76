/* A measurement: what the model expected, whether it is used, what the law and the feedback make of it. */
#include "controller.h"

#include <math.h>
#include <string.h>

#define ALARMS 0.1                /* s: over which the rate of sudden changes is taken */
#define A_WHILE 8                 /* of a period of the stage: a part of it for which the law learns between two waits, at least */
#define RESUME 20                 /* 1/s: the rate below which the feedback continues after a pause */
#define RINGS 4                   /* times the noise's: mean square of the second difference of the error where the stage rings */
#define JUMP 16                   /* times the noise's: what one tick may add to it; a jump is no ringing */
#define RINGING_RATE 50           /* 1/s: how fast that mean follows */
#define LATER ((ts_real)1.2)       /* of the resonance that was found: a third pole of the law, where its weights drift */
#define DAMPS_MOST ((ts_real)0.1) /* of the stroke: what the active damping adds to the command */
#define LARGE_SWING ((ts_real)0.5) /* of that: so much to one side, and to the other one */
#define HALF_WAVE ((ts_real)0.75) /* periods of the stage: within that, is a swing, */
#define DRIVES 8                  /* and so many of them in a row drive the stage, */
#define SHRINKS ((ts_real)0.75)   /* where the last one is not smaller than this times the first one */
#define WITHOUT_STAGE 2           /* times as fast as with a stage in the model the usual error follows without one, */
#define SMALL ((ts_real)0.02)     /* where the error of the motion, over its range, is smaller */
#define UNSURE ((ts_real)10)      /* times the variance of the first slope, for what it was learned from is not white, */
#define ALLOWED ((ts_real)0.5)    /* without so much of what a sudden change adds to it */

/* The regressor of the next tick that was not yet measured. */
static void next_lagged(ts_controller *c)
{
    const ts_settings *s = c->settings;
    int slot = (int)(c->lagged.ticks % TS_HISTORY);
    ts_remember_creep(&c->lagged, s);
    ts_remember_voltage(&c->lagged, s, amplifier_of(c), c->x[slot]);
    ts_follow_slower(c, c->x[slot]);
    ts_regressor(s, &c->lagged, &c->motion[slot], c->u);
}

/* The partial slope that is furthest outside its limits at a rate. */
typedef struct {
    int columns;      /* weights up to its play; 0: none is outside */
    ts_real missing;  /* from it to its limit, um/V */
} violation;

static violation worst_slope(const ts_controller *c, ts_real rate)
{
    const ts_settings *s = c->settings;
    violation worst = {0, 0};
    const ts_real *w = c->w;
    ts_real least = ts_least_slope(c, rate), most = s->slope_max, sum = 0, furthest = 0;
    if (least < s->slope_min) least = s->slope_min;
    for (int i = 0, n = s->plays; i < n; i++) {
        ts_real w_h = *w++;
        if (s->rate_dependent[i]) w_h += rate * *w++;
        sum += w_h;
        if (sum >= least && sum <= most) continue;
        ts_real over = sum - most, under = least - sum, out = over > under ? over : under;
        if (out > furthest) {
            furthest = out;
            worst.columns = (int)(w - c->w);
            worst.missing = over > under ? -over : under;
        }
    }
    return worst;
}

/* It is moved onto its limit, at each end of the velocity: slopes are linear in the rate, so that its two ends are the worst. Both
 * ends take the same sums over the columns of P. */
static void project_slopes(ts_controller *c)
{
    ts_real rate = c->settings->rate_scale * c->fastest;
    ts_column_sums sums;
    sums.columns = 0;
    for (int end = 0; end < 2; end++, rate = -rate) {
        violation worst = worst_slope(c, rate);
        if (worst.columns > 0) ts_kalman_project(&c->law.kalman, c->w, &sums, worst.columns, rate, worst.missing, c->parameters);
    }
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

/* The third pole of the law, as a share per tick; 0: it has none. With given dynamics it is as those of its filter. */
static ts_real third_pole(const ts_controller *c)
{
    if (is_given(c)) return c->law.kalman.filter;
    if (!c->found.known || !(c->stage.before.growth.late > 0)) return 0;
    ts_real w = 2 * TS_PI * LATER * c->stage.resonance;
    return w / (1 + w);
}

/* The regressor and what belongs to it behind this pole, which removes what is beyond the stage of the model. */
static const ts_real *behind_pole(ts_controller *c, const ts_real *u, ts_real *y, bool learn, ts_real pole)
{
    ts_ringing *r = &c->ringing;
    if (!learn) {
        r->started = false;
        return u;
    }
    if (!r->started) {
        memset(r->u, 0, sizeof r->u);
        r->y = 0;
        r->started = true;
    }
    for (int i = 0; i < c->parameters; i += TS_LANES) {
        lanes before = load(r->u + i);
        store(r->u + i, plus(before, pole, difference(load(u + i), before)));
    }
    r->y += pole * (*y - r->y);
    *y = r->y;
    return r->u;
}

/* How fast the usual error follows, to which a change is related; 0: it is not. Without a stage in the model an error that grows
 * slowly would be one change after the other; a large one may be. */
static int relates(const ts_controller *c)
{
    if (dynamics_of(c)->known) return 1;
    return c->law.kalman.small ? WITHOUT_STAGE : 0;
}

/* One tick of the law: u.w should be y; innovation 0 and measured false where the measurement is missing or rejected. */
static void adapt_kalman(ts_controller *c, const ts_real *u, ts_real y, ts_real innovation, bool measured, bool learn)
{
    const ts_settings *s = c->settings;
    ts_kalman *k = &c->law.kalman;
    ts_real space[TS_PADDED(TS_MAX_PARAMETERS)], alone[TS_PADDED(TS_MAX_PARAMETERS)], third = third_pole(c);
    u = ts_without_hum(c, u, &y, alone);
    k->small = c->guard.error < SMALL;
    k->relates = relates(c);
    k->steady = is_given(c) && c->guard.small >= TS_SETTLED;
    k->calm = !dynamics_of(c)->known && c->guard.small > 0;
    if (measures_inertia(c)) u = with_inertia(c, u, &y, learn, space);
    else if (third > 0) u = behind_pole(c, u, &y, learn, third);
    if (!ts_kalman_tick(k, &s->kalman, s->initial_weights, prior_of(s), c->w, u, y, innovation, measured, learn, c->parameters)) return;
    project_slopes(c);
    c->flags.changed = k->changed;
    c->counters.changed += k->changed;
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
    ts_regressor(c->settings, &c->now, &c->motion[last_slot(c)], space);
    for (int i = c->parameters; i < TS_PADDED(c->parameters); i++) space[i] = 0;
    return space;
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

/* Commands that may wait for their measurement. */
static int waiting(const ts_controller *c)
{
    const ts_dynamics *g = dynamics_of(c);
    return TS_HISTORY - (g->known ? g->dead + 4 : 0);
}

/* The same, while the measurements come as late as the last one: a gap in them is passed over tick by tick, so that the first one
 * after it does not take long. */
int ts_patience(const ts_controller *c)
{
    int most = waiting(c), gap = c->answered + TS_BACKLOG - 1;
    return c->answered > 0 && gap < most ? gap : most;
}

/* One notched sample is noise, thousands of times that of z where f0 is far below the sample rate: the law's filters must not start from
 * it. Of the noise of the samples before they have a part alone, so that behind a pause the law waits until it has decayed. Behind
 * the wait it learns for a while, whatever pauses come: a limit that is met in each half-wave of f0 would end all learning. */
static void start_filters(ts_controller *c)
{
    ts_kalman *k = &c->law.kalman;
    ts_real first = c->found.known ? c->stage.resonance : c->settings->dynamics.first;
    int period = (int)(1 / first);
    if (!k->started && c->lagged.ticks > 1 && k->since_change >= period / A_WHILE) ts_kalman_wait(k, period);
    ts_kalman_start_filters(k, c->parameters);
}

/* One tick of the stage with the measurement z, or what was expected in its place: it shows the tick `dead` before. */
static void learn_staged(ts_controller *c, ts_real z, ts_real innovation, bool measured, bool learn)
{
    ts_real u[TS_PADDED(TS_MAX_PARAMETERS)], y = ts_notched(c, z), noisy = ts_quiet(c, innovation);
    c->dynamics.innovation[1] = c->dynamics.innovation[0];
    c->dynamics.innovation[0] = innovation;
    c->dynamics.ticks++;
    if (c->dynamics.ticks <= c->lagged.ticks + (uint64_t)dynamics_of(c)->dead) return;
    while (c->dynamics.ticks > c->lagged.ticks + (uint64_t)dynamics_of(c)->dead) next_lagged(c);
    ts_pass_stage(c, u);
    if (learn) start_filters(c);
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

/* A learned change reaches the command gradually, so that it does not excite the stage. What the law learns just after a sudden change
 * the feedback has corrected already: it hands that over so slowly that it is not corrected twice. */
static void admit_learned(ts_controller *c, ts_real change)
{
    const ts_settings *s = c->settings;
    bool feeds_back = is_given(c) && s->feedback.filters > 0 && !c->feedback.paused;
    if (feeds_back && c->law.kalman.since_change < s->kalman.refractory) c->handed += change;
    else c->bumpless += c->stage.smoothing * change;
}

/* One tick of a filter of the error: b0, b1, b2, a1, a2, and its states. */
static ts_real pass_biquad(const ts_real *q, ts_real *x, ts_real error)
{
    ts_real y = q[0] * error + x[0];
    x[0] = q[1] * error - q[3] * y + x[1];
    x[1] = q[2] * error - q[4] * y;
    return y;
}

/* A swing of the active damping is over, or none came. So many in a row drive the stage, unless they become smaller: the damping has
 * its limit, and what rings far above it takes many swings to end. */
static void count_swing(ts_feedback_state *b, bool late)
{
    b->swings = late ? 0 : b->swings + 1;
    if (b->swings >= DRIVES && b->peak < SHRINKS * b->first) b->swings = 2;
    if (b->swings == 2) b->first = b->peak; /* the one before began with the ringing, anywhere in a swing */
    b->peak = 0;
}

/* One tick of the active damping, um. Where the loop is later than the model knows, it drives what it should damp, up to its limit: from
 * then on there is none. */
static ts_real damp_ringing(ts_controller *c, ts_real error)
{
    ts_feedback_state *b = &c->feedback;
    ts_real most = DAMPS_MOST * c->settings->stroke, sum = pass_biquad(b->damping, b->damped, error), large = LARGE_SWING * most;
    ts_real side = sum > large ? 1 : sum < -large ? -1 : 0;
    if (b->swings >= DRIVES) return 0;
    b->since += 1;
    bool late = b->since * c->stage.resonance > HALF_WAVE, turns = side * b->side < 0;
    if (late || turns) count_swing(b, late);
    if (turns || (size_of(side) > size_of(b->side))) b->since = 0;
    if (size_of(side) > 0) b->side = side;
    if (size_of(sum) > b->peak) b->peak = size_of(sum);
    return within(sum, -most, most);
}

/* The share of the feedback that is used, as cautious control has it: b^2 / (b^2 + P). A small correction passes the slope b of the first
 * play alone, which a slow motion does not show: where it is far too small in the model, the loop has a gain far beyond its margins.
 * They allow for a change of the gain, of which the law is unsure after each sudden change. */
static ts_real share_of_feedback(const ts_controller *c)
{
    ts_real square = c->slopes[0] * c->slopes[0], gain = c->settings->kalman.change_gain;
    ts_real unsure = c->law.kalman.P[0] - ALLOWED * (gain * gain * square);
    return unsure > 0 ? square / (square + UNSURE * unsure) : 1;
}

/* One tick of the feedback, for the command after it. Its margins are those of the stage that was given: one that was found is damped. */
static void feed_back(ts_controller *c, ts_real error)
{
    const ts_feedback *f = &c->settings->feedback;
    ts_feedback_state *b = &c->feedback;
    if (c->found.known) {
        memset(b->state, 0, sizeof b->state);
        b->sum = damp_ringing(c, error);
        return;
    }
    bool waits = f->filters && c->settings->oscillation.tick > 0 && pauses(c);
    ts_real sum = 0, kept = c->settings->dynamics.amplifier;
    if (waits) memset(b->state, 0, sizeof b->state);
    for (int i = 0; !waits && i < f->filters; i++) sum += pass_biquad(f->filter[i], b->state[i], error);
    sum = within(share_of_feedback(c) * sum, -f->most, f->most);
    b->sum = kept > 0 ? sum + kept * (b->sum - sum) : sum; /* its margins are those behind the amplifier, whose lag the command undoes */
}

/* A tick for which no measurement came. */
void ts_pass_over(ts_controller *c)
{
    const ts_settings *s = c->settings;
    c->resonance.ticks = 0; /* its window begins anew */
    ts_hum_miss(c);
    bool learn = !c->limited[c->lagged.ticks % TS_HISTORY];
    if (dynamics_of(c)->known) {
        learn_staged(c, ts_expected(c) + ts_hum_of(c), 0, false, learn);
    } else {
        ts_real space[TS_PADDED(TS_MAX_PARAMETERS)];
        next_lagged(c);
        const ts_real *u = sensed(c, space);
        if (s->law == TS_LAW_KALMAN) adapt_kalman(c, u, model(c, u) + ts_hum_of(c), 0, false, learn);
    }
    if (s->law == TS_LAW_KALMAN) ts_oscillation_miss(&c->oscillation, &s->oscillation, NULL);
    feed_back(c, 0);
}

/* Adapts to z, of which `hum` um are hum; u: the regressor as the sensor shows it, where the stage is not known; `back`: at a voltage limit and beyond
 * the desired displacement. Returns whether z was used. */
static bool learn_from(ts_controller *c, const ts_real *u, ts_real measured, ts_real hum, const ts_motion *d, bool limited, bool back, bool stands)
{
    const ts_settings *s = c->settings;
    ts_kalman *k = &c->law.kalman;
    bool staged = dynamics_of(c)->known;
    ts_real z = measured - hum, predicted = staged ? ts_expected(c) : model(c, u), expected = predicted + hum;
    c->innovation = staged ? z - predicted : through_dead_zones(s, z) + d->ahead - predicted; /* (15) */
    if (s->law == TS_LAW_RLS) return adapt_rls(c, u, !c->hold);
    ts_real noisy = staged ? ts_quiet(c, c->innovation) : c->innovation;
    bool used = !frozen(c, measured, expected, stands), smooth = staged || c->ringing.rings;
    bool spike = used && ts_kalman_is_spike(k, &s->kalman, c->innovation, noisy, smooth);
    ts_real innovation = used && !spike ? c->innovation : 0;
    bool learn = adapts(c, limited, back) && !(c->stage.rest > 0) && !is_restored(c);
    used = used && !spike;
    if (staged) learn_staged(c, used ? measured : expected, innovation, used, learn);
    else adapt_kalman(c, u, expected + innovation, innovation, used, learn);
    if (used) ts_hum_follow(c, innovation);
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
    ts_hum_tick(c);
    ts_real hum = ts_hum_of(c), alone = z - hum;
    bool used = learn_from(c, u, z, hum, d, learned, back, stands);
    if (used && smooth) admit_learned(c, model(c, now) - before);
    const ts_real *slow = staged ? dynamics_of(c)->sensor : s->sensor.slow;
    ts_real error = z - (d->z_d + slow[0] * d->zdot_d + slow[1] * d->zddot_d);
    /* The trim: at a voltage limit only away from it; the slew limit only delays. */
    if (used && (!limited || back)) c->integral -= s->trim * error;
    feed_back(c, used && (!limited || back) ? -ts_without_beyond(c, error) : 0); /* no wind-up at a limit */
    if (used && !staged && s->law == TS_LAW_KALMAN) {
        c->dynamics.z[1] = c->dynamics.z[0];
        c->dynamics.z[0] = alone;
    }
    bool at_limit = c->x[slot] >= s->voltage_max || c->x[slot] <= s->voltage_min;
    if (!used) ts_oscillation_miss(&c->oscillation, &s->oscillation, &error);
    else if (s->law == TS_LAW_KALMAN && s->oscillation.tick > 0 && !staged) ts_watch_stage(c, error, d->zdot_d, ts_was_good(c) ? limited : at_limit);
    if (s->law == TS_LAW_KALMAN && s->oscillation.tick > 0) {
        ts_forget_hum(c);
        ts_listen(c, error, z, d->zdot_d, used);
        ts_watch_resonance(c, alone, error, d, staged);
    }
    if (s->law == TS_LAW_KALMAN) {
        ts_watch_learning(c, error, d->z_d, used && (!at_limit || back));
        if (staged && c->dynamics.ticks != c->lagged.ticks + 1) c->kept.watch.recall.missed.counted = 0; /* u is not that of the measurement before */
        else if (used) ts_watch_kept(c, staged ? c->u : u, staged ? c->dynamics.z[1] : alone);
    }
    return used;
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
        while (measured_ticks(c) < commands - 1 - (uint64_t)ago) ts_pass_over(c);
        used = measure(c, z);
    } else if (in_time && measured_ticks(c) > 0) { /* lost: in its own tick, so that the next one does not take long */
        while (measured_ticks(c) < commands - (uint64_t)ago) ts_pass_over(c);
    }
    c->flags.rejected = !used;
    c->counters.rejected += !used;
    c->counters.adaptations += used && !c->hold;
    return used ? TS_OK : TS_REJECTED;
}
