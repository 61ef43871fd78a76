/* Self-excited oscillation: seen, its frequency measured, ended. */
#include "controller.h"

#include <string.h>

#define BEGUN ((ts_real)0.6)      /* of the motion so far: an oscillation so large, of two half-waves, begins to burst, */
#define BEYOND 2                  /* and times that one of which a half-wave is enough */
#define LOWER ((ts_real)0.7)      /* factor of the filter's corner where it was not low enough */
#define NOT_BELOW ((ts_real)0.2)  /* of the known resonance: a slower error is that of the motion */
#define REST_PERIODS 6            /* of the oscillation: longest pause of adaptation, */
#define REST_HALF_WAVES 7         /* and half-waves of the ringing after which it continues */
#define FREE 6                    /* half-waves of the ringing while weights are held, which shows the resonance, */
#define DECAYED ((ts_real)0.98)   /* of the first of them: the last one is smaller, or something drives it, */
#define LOUDER 2                  /* times a load: a half-wave of an oscillation beside it */
#define UNEVEN 2                  /* times as large as one beside it: the half-wave is not that of a ringing */

/* The present weights are those to be restored; at the start there are no earlier ones. */
void ts_keep_weights(ts_controller *c, bool start)
{
    size_t size = sizeof(ts_real) * (size_t)c->parameters;
    memcpy(c->stage.before.older, start ? c->w : c->stage.newer, size);
    memcpy(c->stage.newer, c->w, size);
    c->stage.age = 0;
}

/* The first time: earlier weights are restored, with the covariance of the prior. Then adaptation pauses, with a lower
 * filter, until the frequency of the ringing is measured. */
static void retreat(ts_controller *c, ts_real frequency)
{
    if (!c->oscillation.found) {
        if (ts_shows_gain(c)) ts_take_first(c, false);
        else memcpy(c->w, c->stage.before.older, sizeof(ts_real) * (size_t)c->parameters);
        ts_keep_weights(c, true);
        ts_kalman_reset_covariance(&c->law.kalman, prior_of(c->settings), c->parameters);
    }
    ts_adopt_resonance(c, frequency, c->oscillation.found ? LOWER * c->law.kalman.filter : 1);
    ts_keep_command(c);
    c->stage.rest = 1 + REST_PERIODS / frequency;
    c->stage.since = c->counters.commands;
    c->oscillation.regular = 0;
    c->oscillation.found = true;
    c->counters.oscillating++;
}

/* While the law rests before anything was good, it learns the gain; what that changes of the command decays, as what went before. */
static void learn_gain(ts_controller *c, ts_real zdot_d)
{
    (void)ts_rate_dependent_slopes(c, zdot_d);
    ts_real before = ts_sum_of_plays(c);
    ts_take_first(c, true);
    (void)ts_rate_dependent_slopes(c, zdot_d);
    c->bumpless += ts_sum_of_plays(c) - before;
}

/* Before anything was good, an error of half of the motion so far is an oscillation from the second half-wave on, one twice as large
 * from the first. */
void ts_watch_burst(ts_controller *c, ts_real error)
{
    const ts_oscillation *o = &c->oscillation;
    const ts_guard *g = &c->guard;
    int n = o->regular > 1 ? 2 : 1;
    bool known = o->found || ts_was_good(c) || g->held > 0 || c->stage.rest > 0 || c->stage.resonance > 0;
    ts_real least = (n > 1 ? 1 : BEYOND) * (BEGUN * ts_guard_range(g, &c->settings->guard)), size = size_of(error);
    if (known || o->regular < 1 || !(size > least && size > c->settings->oscillation.large)) return;
    ts_real frequency = ts_oscillation_frequency(o, n);
    if (ts_oscillation_is_fast(o, frequency)) retreat(c, frequency);
}

/* Ringing at the resonance counts as noise, once in a half-wave. */
static void count_ringing(ts_controller *c)
{
    const ts_oscillation *o = &c->oscillation;
    ts_kalman *k = &c->law.kalman;
    ts_real f = c->stage.resonance;
    if (!(f > 0) || o->length != 0) return;
    ts_real ratio = o->regular >= 2 ? ts_oscillation_frequency(o, 2) / f : 0;
    if (ratio < (ts_real)0.7 || ratio > (ts_real)1.4) {
        k->disturbance /= 2;
        return;
    }
    k->disturbance = ts_kalman_noise_of_sine(k, o->peaks[0], f);
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
    ts_adopt_resonance(c, frequency, c->counters.oscillating > 1 ? c->law.kalman.filter : 1);
    bool late = s->ticks > 0 || s->share > 0 || s->lag > 0;
    if (c->stage.failed || late || c->lagged.ticks < c->stage.since + 4) return;
    if (!c->guard.kept) ts_begin_anew(c);
    ts_adopt_stage(c, frequency, c->oscillation.peaks[0], NULL);
}

/* Whether the last half-waves are those of a ringing that decays: the last one is smaller than the first, and none is twice as large as
 * the one beside it. Those of hum may be, on the error of the motion. */
static bool decays(const ts_real *peaks)
{
    for (int i = 1; i < FREE; i++)
        if (peaks[i] >= UNEVEN * peaks[i - 1] || peaks[i - 1] >= UNEVEN * peaks[i]) return false;
    return peaks[0] < DECAYED * peaks[FREE - 1];
}

/* Whether weights are held and the stage rings on by itself, faster than the motion: it decays, and shows its resonance. */
static bool rings_freely(const ts_controller *c)
{
    const ts_oscillation *o = &c->oscillation;
    const ts_sensor *late = &c->settings->sensor;
    if (c->guard.held == 0 || c->stage.failed || o->length != 0 || o->regular < FREE || c->lagged.ticks < 8) return false;
    if (c->settings->resonance > 0 || late->ticks > 0 || late->share > 0 || late->lag > 0) return false;
    if (!decays(o->peaks)) return false;
    return o->peaks[0] > c->settings->oscillation.floor && ts_oscillation_is_fast(o, ts_oscillation_frequency(o, FREE));
}

/* Whether an oscillation of this frequency, cycles per tick, is hum, or the load that was seen. */
static bool is_load(const ts_controller *c, ts_real frequency)
{
    const ts_resonance *r = &c->resonance;
    if (ts_is_hum(c, frequency, c->oscillation.peaks[0])) return true;
    return r->load > 0 && c->oscillation.peaks[0] < LOUDER * r->load && size_of(frequency / r->load_at - 1) < TS_OF_LOAD;
}

/* One tick of the detection of a self-excited oscillation, and the reaction to it. */
void ts_watch_stage(ts_controller *c, ts_real error, ts_real zdot_d, bool limited)
{
    const ts_settings *s = c->settings;
    ts_oscillation *o = &c->oscillation;
    ts_real found = ts_oscillation_tick(o, &s->oscillation, error, zdot_d, noise_of(c), ts_was_good(c));
    if (limited) o->sign = o->regular = 0; /* the law does not cause the error there; before anything was good, only a voltage at its limit is one */
    count_ringing(c);
    if ((c->guard.held > 0 || c->stage.rest > 0) && ts_shows_gain(c)) learn_gain(c, zdot_d);
    if (rings_freely(c)) {
        c->stage.resonance = ts_oscillation_frequency(o, FREE);
        c->stage.rest = 0;
        c->flags.oscillating = false;
        ts_resonance_look(&c->resonance, c->stage.resonance);
        ts_begin_anew(c);
        ts_adopt_stage(c, c->stage.resonance, o->peaks[0], NULL);
        return;
    }
    if (c->stage.rest > 0) {
        c->stage.rest = o->regular >= REST_HALF_WAVES || c->stage.rest < 1 ? 0 : c->stage.rest - 1;
        if (!(c->stage.rest > 0) && o->regular >= 4) {
            ts_real frequency = ts_oscillation_frequency(o, o->regular < 6 ? 4 : 6);
            if (ts_oscillation_is_fast(o, frequency)) know_resonance(c, frequency);
        }
    } else if (found > 0 && c->guard.held == 0 && !(o->found && measures_inertia(c)) && !limited && found > NOT_BELOW * c->stage.resonance && !c->hold && !is_load(c, found)) {
        retreat(c, found);
    } else {
        c->stage.age += s->oscillation.tick;
        if (c->stage.age > (ts_real)TS_KEEP && o->regular < 3) ts_keep_weights(c, false);
    }
    c->flags.oscillating = c->stage.rest > 0;
}
