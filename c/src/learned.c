/* Never worse than not learning: the guard's decisions, and the weights that are kept for them. */
#include "controller.h"

#include <string.h>

#define SLOWER 8                    /* times as slow as the poles of the oscillation: the pole of the first gain */
#define NO_LESS ((ts_real)0.5)      /* of the least first slope: a smaller one is none of the actuator, while the motion grows */
#define SURE 10                     /* of a window: for so long a displacement of the floor is as sure as the first gain */
#define MOST_GAIN ((ts_real)20)     /* times the first gain, or a share of it */
#define FALLEN ((ts_real)0.8)       /* of an error that the dynamics leave: learning makes it smaller */
#define MOST_CAUTION ((ts_real)0.1) /* of the motion's range: the largest error that counts as noise after learning has failed */
#define CAUTIOUS 100                /* times the variance of a measurement: from there on the law follows no drift */

#define WIDER ((ts_real)1.05)       /* times the range of the motion so far: a larger motion, */
#define FOLLOWED ((ts_real)0.02)    /* once the error is less of it: a larger one may be that of another stage */

#define BLOCK ((ts_real)0.25)       /* s: over which an error is taken */
#define GREW ((ts_real)1.4)         /* times the least of a block: an error that has grown, */
#define GROWN 2                     /* in so many blocks in a row, */
#define LEAST_GROWN ((ts_real)1e-3) /* of the motion's range at least, */
#define NOISES_GROWN 3              /* and so many standard deviations of a measurement */
#define RISES ((ts_real)1.2)        /* times that of the window before: an error that has risen, */
#define RISING 4                    /* in so many windows in a row, */
#define ABOVE 4                     /* to so many times the least */
#define AS_FAST ((ts_real)1.2)      /* times as fast, or as slow: another motion */
#define SETTLED_HELD 3              /* windows until held weights are judged */
#define HELPS ((ts_real)0.8)        /* of the error that had grown: earlier weights are better, */
#define AS_GOOD ((ts_real)1.3)      /* and, times the least, as good as they were */
#define AT_ONCE ((ts_real)1.5)      /* times the error that had grown: held weights are not waited for, */
#define RINGS_OUT 1                 /* behind so many windows in which the stage still rings of their coming */
#define WORN ((ts_real)1.5)         /* times the error that they had at first: they are old */
#define FIRST_HOLD 4                /* blocks of the first hold, */
#define LONGEST_HOLD 256            /* and of the longest */

static void weights_at_best(ts_controller *c)
{
    ts_controller_complete(c);
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

/* What was known of the stage when weights were kept: they belong to it. */
static void stage_at_best(ts_controller *c)
{
    c->stage.resonance = c->kept.resonance;
    c->stage.inertia = c->kept.inertia;
    c->stage.smoothing = c->kept.smoothing;
    c->law.kalman.filter = c->kept.filter;
    c->oscillation.found = c->kept.oscillated;
}

/* A stage on trial has failed: without it, and without its resonance, unless an oscillation has shown that since. */
static void end_trial(ts_controller *c)
{
    if (!c->stage.trial || !c->found.known) return;
    bool shown = c->oscillation.found && !c->kept.oscillated;
    ts_give_up_stage(c);
    if (shown || c->kept.staged || c->kept.begun || c->settings->dynamics.known) return;
    stage_at_best(c);
    ts_look_ahead_anew(c);
}

/* Until there are better ones, the first weights are the best. */
void ts_keep_start(ts_controller *c)
{
    if (c->settings->law != TS_LAW_KALMAN) return;
    ts_keep_weights(c, true);
    memcpy(c->kept.first, c->w, sizeof(ts_real) * (size_t)c->parameters);
    memcpy(c->kept.w, c->w, sizeof(ts_real) * (size_t)c->parameters);
    c->guard.wait = TS_FIRST_WAIT;
}

/* One tick of the gain of the first weights. z belongs to the regressor u. */
static void follow_gain(ts_controller *c, const ts_real *u, ts_real z)
{
    const ts_settings *s = c->settings;
    ts_first_gain *g = &c->kept.watch.gain;
    ts_real slow = s->oscillation.slow / SLOWER, expected = within(dot(c->kept.first, u, TS_PADDED(c->parameters)), -TS_LARGEST, TS_LARGEST);
    if (g->ticks == 0) {
        g->product = g->square = s->guard.floor * s->guard.floor * (ts_real)s->guard.window / SURE;
        g->first = z;
        g->from = expected;
        g->z = g->expected = 0;
        g->ticks = 1;
    }
    g->z += slow * (z - g->first - g->z);
    g->expected += slow * (expected - g->from - g->expected);
    g->product = within(g->product + g->z * g->expected, -TS_LARGEST * TS_LARGEST, TS_LARGEST * TS_LARGEST);
    g->square = within(g->square + g->expected * g->expected, 0, TS_LARGEST * TS_LARGEST);
}

/* The weight of the offset moves by so much, um. */
void ts_move_offset(ts_controller *c, ts_real by)
{
    if (!c->settings->terms[TS_OFFSET]) return;
    ts_real *offset = &c->w[ts_column(c->settings, TS_OFFSET)];
    *offset = within(*offset + by, -TS_LARGEST, TS_LARGEST);
}

/* The command goes on from where it is. The feedback waits, for its margins are those of a model that has been learned. */
static void hand_over(ts_controller *c)
{
    ts_keep_command(c);
    c->feedback.alarms = 2 * PAUSE;
}

/* Whether weights were good, now or before the model was lost. */
bool ts_was_good(const ts_controller *c)
{
    return c->guard.kept || c->guard.lost;
}

/* Times that of the first weights. */
static ts_real gain_of(const ts_first_gain *g)
{
    return within(g->product / g->square, 1 / MOST_GAIN, MOST_GAIN);
}

/* Whether measurements have shown the gain of the first weights: until others were good. */
bool ts_shows_gain(const ts_controller *c)
{
    const ts_first_gain *g = &c->kept.watch.gain;
    return !ts_was_good(c) && g->ticks > 0 && g->product > 0 && !ts_is_identified(c);
}

/* The least partial slope at a rate, um/V; 0: any may be. Until weights were good, in a motion that grows, ringing looks like a slope that
 * is too small; none is far below the least of the first weights, with the gain that was shown. */
ts_real ts_least_slope(const ts_controller *c, ts_real rate)
{
    const ts_settings *s = c->settings;
    if (s->guard.window == 0 || c->guard.grown || ts_was_good(c)) return 0;
    const ts_real *w = c->kept.first;
    ts_real gain = ts_shows_gain(c) ? gain_of(&c->kept.watch.gain) : 1, least = TS_LARGEST, sum = 0;
    for (int i = 0; i < s->plays; i++) {
        ts_real w_h = *w++;
        if (s->rate_dependent[i]) w_h += rate * *w++;
        sum += w_h;
        if (sum < least) least = sum;
    }
    return NO_LESS * least * (gain < 1 ? gain : 1);
}

/* The first weights, with the gain that was measured, from the first measurement on. With `gain_only` terms beside the plays stay. */
void ts_take_first(ts_controller *c, bool gain_only)
{
    const ts_first_gain *g = &c->kept.watch.gain;
    bool shown = ts_shows_gain(c);
    ts_real gain = shown ? gain_of(g) : 1;
    int changed = gain_only ? c->of_plays : c->parameters;
    memcpy(c->w, c->kept.first, sizeof(ts_real) * (size_t)changed);
    for (int i = 0; i < c->of_plays; i++) c->w[i] *= gain;
    if (shown && !gain_only) ts_move_offset(c, g->first - gain * g->from);
}

/* Other weights; earlier ones miss what has drifted since. While weights are held the filters of the law are not started: those of the
 * start then predict what the held ones do. */
static void take_weights(ts_controller *c, const ts_real *w, bool earlier)
{
    const ts_kalman *k = &c->law.kalman;
    ts_real before = model(c, c->u);
    memcpy(c->w, w, sizeof(ts_real) * (size_t)c->parameters);
    if (earlier && k->started) ts_move_offset(c, k->y - model(c, k->u));
    else if (earlier && c->guard.at_start) ts_move_offset(c, before - model(c, c->u));
    hand_over(c);
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

/* At the end of a window: where the motion has become larger, the weights are not as sure as they seemed. In a smaller one what the
 * model of the stage misses was as small as the noise, and the law took it for knowledge. */
static void doubt_outgrown(ts_controller *c)
{
    ts_real range = ts_guard_range(&c->guard, &c->settings->guard), *widest = &c->stage.widest;
    if (!dynamics_of(c)->known) *widest = 0;
    else if (!(c->guard.held > 0) && c->guard.error < FOLLOWED) {
        bool outgrown = range > WIDER * *widest, slow = c->settings->terms[TS_COUPLING] > 0; /* as y of a scan */
        if (outgrown || (slow && range > *widest)) *widest = range;
        if (outgrown) c->law.kalman.outgrown = true;
    }
}

/* Nothing is known of the present error, and nothing held; what a hold has shown stays, but for another stage. */
void ts_begin_growth(ts_controller *c, bool first)
{
    ts_growth *g = &c->stage.before.growth;
    ts_real wait = first ? FIRST_HOLD : g->wait, late = first ? 0 : g->late;
    memset(&c->stage.before, 0, sizeof c->stage.before);
    g->wait = wait;
    g->late = late;
}

/* The stage is no longer in the model: the weights to be restored are those at their best. */
void ts_end_growth(ts_controller *c)
{
    c->ringing.started = false;
    memcpy(c->stage.newer, c->kept.w, sizeof(ts_real) * (size_t)c->parameters);
    memcpy(c->stage.before.older, c->kept.w, sizeof(ts_real) * (size_t)c->parameters);
    c->stage.age = 0;
}

/* The weights of this block have the least error. */
static void keep_least(ts_controller *c, const ts_real *w, ts_real error, ts_real speed)
{
    ts_growth *g = &c->stage.before.growth;
    memmove(c->stage.newer, w, sizeof(ts_real) * (size_t)c->parameters);
    g->known = 1;
    g->least = error;
    g->swift = speed;
    g->bad = 0;
}

/* The law continues, when its filters have settled: after a period of the stage. */
static void learn_on(ts_controller *c)
{
    c->stage.before.growth.held = 0;
    ts_kalman_wait(&c->law.kalman, (int)(1 / c->stage.resonance));
}

/* The least error over the range that has grown: a smaller one is noise. */
static ts_real least_grown(const ts_controller *c, ts_real noise)
{
    ts_real least = NOISES_GROWN * noise / ts_guard_range(&c->guard, &c->settings->guard);
    return least < LEAST_GROWN ? LEAST_GROWN : least;
}

/* The weights with the least error, for this one. */
static void hold_least(ts_controller *c, ts_real error)
{
    ts_growth *g = &c->stage.before.growth;
    memcpy(c->kept.aside, c->w, sizeof(ts_real) * (size_t)c->parameters);
    take_weights(c, c->stage.newer, true);
    g->failed = error;
    g->held = 1;
    g->good = 0;
    c->counters.restored++;
}

/* A block of the weights that learn: where the error has grown while the motion is as fast, those with the least error are held. */
static void judge_growth(ts_controller *c, ts_real error, ts_real speed, bool other, ts_real noise)
{
    ts_growth *g = &c->stage.before.growth;
    if (g->left > 0) g->left -= 1;
    if (!(g->known > 0) || other || error <= g->least) {
        keep_least(c, c->w, error, speed);
        return;
    }
    bool grew = error > GREW * g->least && error > least_grown(c, noise) && !(g->left > 0);
    g->bad = grew ? g->bad + 1 : 0;
    if (!(g->bad < (g->wait > FIRST_HOLD ? 1 : GROWN))) hold_least(c, error); /* after a hold one is enough */
}

/* At the end of a window: whether the error has risen in each of the last ones to many times that of the weights that are kept, which
 * promise to be better, in a motion that is as fast as before and goes through its range in a window. */
static bool has_risen(ts_controller *c, ts_real noise)
{
    const ts_guard *guard = &c->guard;
    ts_growth *g = &c->stage.before.growth;
    ts_real window = (ts_real)c->settings->guard.window, time = window * c->settings->oscillation.tick, range = ts_guard_range(guard, &c->settings->guard);
    bool passes = g->pace * (time * time) > window * (range * range), as_fast = g->pace < AS_FAST * AS_FAST * g->paced;
    bool rises = passes && as_fast && g->before > 0 && guard->error > RISES * g->before;
    g->rising = rises ? g->rising + 1 : 0;
    g->before = guard->error;
    g->paced = g->pace;
    g->pace = 0;
    bool of_model = guard->kept && !c->kept.begun && c->kept.staged == dynamics_of(c)->known;
    return of_model && g->rising >= RISING && guard->error > least_grown(c, noise) && guard->error > ABOVE * guard->best && ts_guard_promises(guard, guard->error);
}

/* The first block of the held weights: the law goes on from there with a third pole, unless it had that; then they stay, if they are
 * as good as they were. Where they are no better, learning was not the cause. */
static void judge_restored(ts_controller *c, ts_real error, ts_real speed, bool burst)
{
    ts_growth *g = &c->stage.before.growth;
    bool before = g->late > 0;
    if (burst || error > HELPS * g->failed) {
        ts_real failed = g->failed;
        take_weights(c, c->kept.aside, false);
        learn_on(c);
        ts_begin_growth(c, false);
        keep_least(c, c->kept.aside, failed, speed);
        g->left = g->wait;
        return;
    }
    g->late = 1;
    g->good = error;
    if (!before || error > AS_GOOD * g->least) {
        keep_least(c, c->stage.newer, error, speed);
        learn_on(c);
        return;
    }
    g->left = g->wait;
    g->wait = g->wait < LONGEST_HOLD ? 2 * g->wait : LONGEST_HOLD;
}

/* Each further one: the law goes on when the hold ends, or they are old. */
static void judge_hold(ts_controller *c, ts_real error, ts_real speed, bool other, bool burst)
{
    ts_growth *g = &c->stage.before.growth;
    bool worn = other || burst || error > WORN * g->good;
    g->left -= 1;
    if (g->left > 0 && !worn) return;
    learn_on(c);
    if (worn && (other || g->left > 0)) ts_begin_growth(c, false);
    else keep_least(c, c->stage.newer, error, speed);
}

/* One tick beside the guard, with a stage that was found: an error that grows, far below what the guard takes for a failure. */
static void watch_growth(ts_controller *c, ts_real noise)
{
    const ts_guard *guard = &c->guard;
    ts_growth *g = &c->stage.before.growth;
    if (!c->found.known) return;
    if (guard->held > 0 || c->stage.trial || c->flags.changed) {
        ts_begin_growth(c, false);
        return;
    }
    g->speed += c->rate * c->rate;
    g->ticks += 1;
    g->pace += c->rate * c->rate;
    if (g->held > 0) ts_move_offset(c, guard->drift);
    if (guard->ticks > 0) return; /* within a window */
    if (has_risen(c, noise) && !(g->held > 0)) {
        keep_least(c, c->kept.w, guard->best, root_of(g->paced / (ts_real)c->settings->guard.window));
        hold_least(c, guard->error);
        g->windows = g->square = g->speed = g->ticks = g->rising = 0;
    }
    bool burst = g->held > RINGS_OUT && guard->error > AT_ONCE * g->failed;
    if (g->held > 0) g->held += 1;
    if (g->held > 0 && g->held <= SETTLED_HELD && !burst) {
        g->speed = g->ticks = 0;
        return;
    }
    g->windows += 1;
    g->square += guard->error * guard->error;
    if (!burst && g->windows * ((ts_real)c->settings->guard.window * c->settings->oscillation.tick) < BLOCK) return;
    ts_real error = root_of(g->square / g->windows), speed = root_of(g->speed / g->ticks);
    bool other = g->known > 0 && (speed > AS_FAST * g->swift || AS_FAST * speed < g->swift);
    g->windows = g->square = g->speed = g->ticks = 0;
    if (other) g->wait = FIRST_HOLD;
    if (!(g->held > 0)) judge_growth(c, error, speed, other, noise);
    else if (g->good > 0) judge_hold(c, error, speed, other, burst);
    else judge_restored(c, error, speed, burst);
}

/* After a bad window, or one whose error rises: what the weights that would be restored miss of the filtered measurement, if they belong to the model as it is. */
static void compare_kept(ts_controller *c)
{
    const ts_kalman *k = &c->law.kalman;
    bool begun = c->kept.begun, other = c->stage.trial || (!begun && c->kept.staged != dynamics_of(c)->known);
    if (!k->started || other || ts_shows_gain(c)) return;
    ts_guard_compare(&c->guard, k->y - dot(k->u, begun ? c->kept.first : c->kept.w, TS_PADDED(c->parameters)));
}

void ts_watch_learning(ts_controller *c, ts_real error, ts_real z_d, bool counts)
{
    const ts_settings *s = c->settings;
    ts_guard *g = &c->guard;
    ts_kalman *k = &c->law.kalman;
    if (s->guard.window == 0 || c->hold) return;
    bool resting = c->stage.rest > 0 && g->held == 0;
    ts_real noise = g->kept ? c->kept.sigma : k->sigma;
    if (noise < c->resolution) noise = c->resolution;
    if (c->stage.resonance > 0) g->swings = 0; /* known: what rings there is judged by its windows */
    if (!dynamics_of(c)->known) ts_watch_burst(c, error);
    bool kept = g->kept;
    bool rising = c->found.known && c->stage.before.growth.rising >= RISING - 1;
    if ((g->bad > 0 || rising) && counts && !resting) compare_kept(c);
    switch (ts_guard_tick(g, &s->guard, error, z_d, counts && !resting, noise)) {
    case TS_GUARD_KEEP:
        weights_at_best(c);
        c->stage.trial = false;
        break;
    case TS_GUARD_RESTORE:
        memcpy(c->kept.aside, c->w, sizeof(ts_real) * (size_t)c->parameters);
        end_trial(c);
        if (ts_shows_gain(c)) {
            ts_take_first(c, false);
            hand_over(c);
        } else take_weights(c, c->kept.begun ? c->kept.first : c->kept.w, !(g->kept && g->swings >= TS_SWINGS)); /* a swing is no offset */
        c->counters.restored++;
        break;
    case TS_GUARD_FIRST:
        if (!ts_stage_is_shown(c)) ts_give_up_stage(c);
        take_weights(c, c->kept.first, true);
        break;
    case TS_GUARD_ADOPT: learn_cautiously(c); break;
    case TS_GUARD_RETURN:
        if (c->found.known && !ts_stage_is_shown(c)) {
            ts_give_up_stage(c);
            take_weights(c, c->kept.first, true);
            ts_kalman_reset_covariance(k, prior_of(s), c->parameters);
        } else {
            bool of_motion = c->stage.resonance < ts_resonance_lowest(&c->resonance, s->oscillation.tick);
            if (of_motion && !(s->resonance > 0 || dynamics_of(c)->known)) { /* it was no resonance */
                ts_forget_stage(c);
                c->oscillation.found = false;
            }
            take_weights(c, c->kept.aside, false);
        }
        break;
    case TS_GUARD_NOTHING:
    default: break;
    }
    if (g->kept != kept && !g->lost) memset(&c->kept.watch, 0, sizeof c->kept.watch);
    if (g->ticks == 0 && is_given(c)) doubt_dynamics(c, g->error);
    if (g->ticks == 0) doubt_outgrown(c);
    if (g->held > 0 || k->caution > CAUTIOUS * (k->sigma * k->sigma)) ts_move_offset(c, g->drift);
    if (g->held == 0 && g->ticks == 0) k->caution *= 1 - (ts_real)0.8 / (ts_real)g->wait;
    watch_growth(c, noise);
    c->flags.restored = is_restored(c);
}

/* The kept weights again, moved by this offset, um, and what was known of the stage with them. */
static void recall(ts_controller *c, ts_real offset)
{
    ts_kalman *k = &c->law.kalman;
    ts_resonance *r = &c->resonance;
    bool staged = c->found.known;
    ts_end_amplifier(c);
    c->found.known = c->stage.trial = c->ringing.started = false;
    c->stage.failed = c->kept.failed;
    c->stage.rest = 0;
    stage_at_best(c);
    if (staged) ts_look_ahead_anew(c);
    c->oscillation.sign = c->oscillation.regular = 0;
    r->known = r->variance = 0;
    r->windows = r->ticks = 0;
    ts_kalman_reset_covariance(k, (ts_prior){c->kept.P, NULL}, c->parameters);
    k->sigma = c->kept.sigma;
    k->disturbance = k->caution = 0;
    take_weights(c, c->kept.w, false);
    ts_move_offset(c, offset);
    ts_keep_weights(c, true);
    ts_keep_command(c);
    ts_guard_recall(&c->guard);
    c->counters.restored++;
    c->flags.oscillating = false;
    c->flags.restored = true; /* in this tick */
}

/* While the model is lost: whether the kept weights predict the measurements again, without a stage that was found since. z belongs
 * to the regressor u. */
void ts_watch_kept(ts_controller *c, const ts_real *u, ts_real z)
{
    const ts_settings *s = c->settings;
    const ts_guard *g = &c->guard;
    bool watched = s->guard.window > 0 && s->oscillation.tick > 0;
    if (watched && !ts_was_good(c) && !dynamics_of(c)->known) {
        follow_gain(c, u, through_dead_zones(s, z));
        return;
    }
    if (!g->lost || c->kept.staged || c->hold || c->lagged.ticks < 2) {
        c->kept.watch.recall.missed.counted = 0;
        return;
    }
    ts_real change = c->motion[(c->lagged.ticks - 1) % TS_HISTORY].zdot_d - c->motion[(c->lagged.ticks - 2) % TS_HISTORY].zdot_d;
    ts_real predicted = dot(c->kept.w, u, TS_PADDED(c->parameters)), offset = 0;
    ts_real missed = through_dead_zones(s, z) + c->kept.inertia * change - predicted;
    ts_real noise = c->kept.sigma > c->resolution ? c->kept.sigma : c->resolution;
    if (ts_recall_tick(&c->kept.watch.recall, &s->guard, predicted, missed, ts_guard_range(g, &s->guard), noise, &offset)) recall(c, offset);
}
