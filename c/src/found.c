/* The resonance that is measured while the stage moves: what follows from it, and the stage that is made of it. */
#include "controller.h"

#include <string.h>

#define FOUND ((ts_real)0.2)      /* relative standard deviation of the inertia of a resonance that an oscillation has */
#define STEP_TERMS 32             /* of a series: enough up to half of the sample rate */
#define FOUND_FILTER ((ts_real)0.6) /* of a stage that was found: corner of the law's filter over its resonance, */
#define FOUND_LAG ((ts_real)0.1)  /* and standard deviations of what lag and inertia of it miss, over 1 / w0 and 1 / w0^2 */
#define FOUND_INERTIA ((ts_real)0.05)
#define STIFF ((ts_real)0.12)     /* cycles per tick: from here on a tick of dead time is more than that lag */
#define CERTAIN ((ts_real)0.02)   /* relative deviation of a resonance that takes the place of another one in the model, */
#define CERTAIN_AT_FIRST ((ts_real)0.05) /* and of one where no stage was in the model, until one has failed */
#define MOVED ((ts_real)0.015)    /* of the resonance of the model: one that is shown and differs by so much replaces it */
#define FURTHER ((ts_real)0.15)   /* unless by so much */
#define ELSEWHERE ((ts_real)0.03) /* of the first resonance of the settings: one that differs by so much, where learning has failed */
#define MAY_BE_SECOND ((ts_real)1.5) /* times the first resonance so far: what is shown above may be the second mode */
#define DRIVEN ((ts_real)0.5)     /* share of the plays: what our voltage does not drive is of another axis, or comes from outside */
#define ANOTHER ((ts_real)0.07)   /* of the first resonance of the settings: one that differs by so much is that of another stage */
#define SLOWEST ((ts_real)0.025)  /* of the resonance: a slower motion does not need it */
#define NOISY 9                   /* times the variance of a measurement: nor does a smaller error, */
#define SHAKEN ((ts_real)5e-4)    /* of the motion's range: unless the stage rings by so much, */
#define BY_CHANCE 6               /* and with more than so many such errors in a window: noise alone has half of them */
#define TRIED ((ts_real)0.1)      /* of a stage that missed more than the law, or failed: what is shown so near to it is it */
#define MOST_SENSITIVE ((ts_real)0.2) /* of a resonance: where fewer plays move it further, it is as doubtful as one after another that failed, */
#define KNOWN ((ts_real)0.01)     /* until its relative deviation is so small; */
#define STANDS_ALONE ((ts_real)0.1) /* further than this, ringing alone does not show it, where the law is good without it */
#define AGREES ((ts_real)0.05)    /* with the resonance that the estimate knows: its lag is that of this stage, and the last window is one of it */
#define SEEN ((ts_real)4e-3)      /* of the motion's range: a smaller error of what is good shows no other resonance */
#define TURNS ((ts_real)0.2)      /* radians at the resonance: a smaller lag is a matter of the weights */
#define TURNED ((ts_real)0.5)     /* radians: a stage in the model whose lag turns it by so much, */
#define WHOLE ((ts_real)0.75)     /* and takes so many ticks, has another dead time */
#define MOST_GAINED ((ts_real)5)  /* times their first gain: plays that have more, or less than a fifth, have learned from a wrong sensor */
#define BURSTS ((ts_real)0.05)    /* of the motion's range: an error for which the stage is looked for in haste */
#define LATE (2 * TS_MOST_DEAD)   /* ticks before a measurement: its stage knows no earlier strains */
#define DAMPS ((ts_real)0.2)      /* of the ringing: what the active damping takes from the command, a quarter of a period later, */
#define BROAD ((ts_real)1)        /* behind a filter of twice this damping, */
#define STIFFEST ((ts_real)0.06)  /* cycles per tick: less of it above, where what is not known of the lag turns it further, */
#define HIGHEST_DAMPED ((ts_real)0.25) /* and nothing from here on */
#define LOUD ((ts_real)0.1)       /* of the motion's range: an error with which given dynamics may be wrong, whatever tone is in it */
#define STEADY_BESIDE_GIVEN ((ts_real)0.9) /* as TS_STEADY_TONE, where dynamics are given, which leave */
#define NOT_URGENT ((ts_real)0.03) /* of the motion's range: a smaller error */
#define OF_SECOND ((ts_real)0.04) /* of it: one with which they may be wrong, and what is shown may be the second mode */
#define LOAD_COUNTS ((ts_real)0.04) /* of a sine that decays: a load lasts, and little of it remains in the mean */
#define AS_GOOD_AS_NONE ((ts_real)1e-6) /* of the prior's variance: of a weight that stays */

#define SLOW ((ts_real)2.6)       /* radians at the resonance: a first-order lag that is larger is the amplifier's */
#define WITHOUT_DEAD ((ts_real)1.5) /* ticks of what the estimate shows as a first-order lag: of the hold and the rest of the dead time */

/* Radians at the centre of the estimate, of the lags that the voltage is followed behind. */
static const ts_real LAGS[TS_SLOWER] = {SLOW, (ts_real)3.7, (ts_real)5.2, (ts_real)7.5};

/* exp(d x) of so many ticks d of dead time, times the inverse of the hold, 1 - x^2 / 12 + x^4 / 240: coefficients of x to x^4. */
void ts_lead_of_dead_time(int dead, ts_real *first, ts_real *second, ts_real *third, ts_real *fourth)
{
    ts_real d = (ts_real)dead, square = d * d, cube = square * d, rest = (square * square - square) / 24;
    *first = d;
    *second = (6 * square - 1) / 12;
    *third = (2 * cube - d) / 12;
    *fourth = rest + (ts_real)1 / 240;
}

/* The term of the inertia where the first resonance is at `frequency` cycles per tick, s; 0: not known. */
static ts_real inertia_of(const ts_settings *s, ts_real frequency)
{
    ts_real w = 2 * TS_PI * frequency;
    return frequency > 0 ? s->oscillation.tick / (w * w) : 0;
}

/* Quantities that follow from a measured resonance: the law's filter ends at half of it (at it where the inertia is learned),
 * and is no higher than `highest` unless that is far lower; a learned change takes a period of it to reach the command, which
 * includes the inertia. */
void ts_adopt_resonance(ts_controller *c, ts_real frequency, ts_real highest)
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
    ts_keep_command(c);
}

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
void ts_make_dynamics(ts_dynamics *g, ts_real frequency, ts_real tick, int dead)
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
    ts_lead_of_dead_time(dead, &first, &second, &third, &fourth);
    g->lead[0] = 2 * FOUND_DAMPING / w0 + first * tick;
    g->lead[1] = 1 / (w0 * w0) + first * (2 * FOUND_DAMPING * tick / w0) + second * (tick * tick);
}

/* A weight is this, independent of all others, with this variance. */
static void put_weight(ts_controller *c, int place, ts_real weight, ts_real variance)
{
    c->w[place] = weight;
    ts_kalman_separate(&c->law.kalman, place, variance, c->parameters);
}

/* What was learned without the stage is wrong, and so is how sure it is. */
void ts_begin_anew(ts_controller *c)
{
    ts_take_first(c, false);
    ts_kalman_reset_covariance(&c->law.kalman, prior_of(c->settings), c->parameters);
}

/* What was learned without the stage is good enough for its command, but as a whole it may be as wrong as it is far from the first
 * weights. Until the law's filters have settled, a period of the stage, nothing is learned. */
static void doubt_learned(ts_controller *c, ts_real frequency)
{
    ts_real learned[TS_PADDED(TS_MAX_LEARNED)] = {0};
    for (int i = 0; i < c->parameters; i++) learned[i] = c->w[i] - c->kept.first[i];
    ts_kalman_renew(&c->law.kalman, learned, (int)(1 / frequency), c->parameters);
}

/* Ticks of dead time that the estimate shows, where so many are in the model. */
static int shown_dead(const ts_resonance *r, int before)
{
    return (int)within((ts_real)before + r->lag + (ts_real)0.5, 0, TS_MOST_DEAD);
}

/* Whole ticks of dead time of a stage of this frequency, in place of so many `before`. Where the estimate knows that stage, and its
 * lag is not small beside a period, they are that lag. */
static int dead_time(ts_controller *c, ts_real frequency, int before)
{
    ts_resonance *r = &c->resonance;
    int dead = 1;
    if (r->windows > 0 && size_of(frequency / r->known - 1) < AGREES) {
        ts_real turns = size_of(r->lag) * 2 * TS_PI * frequency;
        dead = turns > TURNS ? shown_dead(r, before) : before;
    }
    if (c->settings->dynamics.known) dead = c->settings->dynamics.dead;
    r->lag -= (ts_real)(dead - before);
    r->first_order -= (ts_real)(dead - before);
    if (dead != before) r->ticks = 0;
    return dead;
}

/* One tick of the voltages behind each of the lags, with this one, V. */
void ts_follow_slower(ts_controller *c, ts_real x)
{
    ts_real w = 2 * TS_PI * c->resonance.centre;
    if (!(w > 0)) return;
    for (int i = 0; i < TS_SLOWER; i++) c->slower[i] += w / (w + LAGS[i]) * (x - c->slower[i]);
}

/* Ticks of the lag of an amplifier before a stage of this frequency; 0: none is shown. A dead time that turns the resonance as far is
 * shown as a smaller lag, or has more ticks than any here. */
static ts_real lag_of_amplifier(const ts_controller *c, ts_real frequency)
{
    const ts_resonance *r = &c->resonance;
    ts_real w = 2 * TS_PI * frequency, t = r->first_order - WITHOUT_DEAD;
    bool known = r->windows > 0 && size_of(frequency / r->known - 1) < AGREES && !c->settings->dynamics.known;
    return known && t > TS_MOST_DEAD && t * w > SLOW ? within(t, 0, LAGS[TS_SLOWER - 1] / w) : 0;
}

/* What `lagged` has seen of the voltage behind a lag of so many ticks, V. */
static ts_real behind_lag(const ts_controller *c, ts_real ticks)
{
    ts_real radians = within(ticks * (2 * TS_PI * c->resonance.centre), LAGS[0], LAGS[TS_SLOWER - 1]);
    int i = 1;
    while (i < TS_SLOWER - 1 && radians > LAGS[i]) i++;
    ts_real share = (radians - LAGS[i - 1]) / (LAGS[i] - LAGS[i - 1]);
    return c->slower[i - 1] + share * (c->slower[i] - c->slower[i - 1]);
}

/* The voltage that the plays of the last measured tick see is another one, V; those of the command follow it. */
static void move_all(ts_controller *c, ts_real to)
{
    uint64_t ticks = c->now.ticks;
    ts_move_voltage(&c->lagged, c->settings, to);
    c->now = c->lagged;
    for (uint64_t k = c->lagged.ticks; k < ticks; k++) {
        ts_remember_creep(&c->now, c->settings);
        ts_remember_voltage(&c->now, c->settings, amplifier_of(c), c->x[k % TS_HISTORY]);
    }
}

/* From now on the plays see the voltage behind a lag of so many ticks, and have seen it. */
static void begin_amplifier(ts_controller *c, ts_real ticks)
{
    c->found.amplifier = ticks / (1 + ticks);
    c->resonance.lag = c->resonance.first_order = 0;
    c->resonance.ticks = 0;
    move_all(c, behind_lag(c, ticks));
}

/* The plays see the voltage itself again, where an amplifier was found with the stage. */
void ts_end_amplifier(ts_controller *c)
{
    if (!c->found.known || !(c->found.amplifier > 0)) return;
    c->found.amplifier = 0;
    move_all(c, c->x[(c->lagged.ticks - 1) % TS_HISTORY]);
}

/* Active damping of a stage of this frequency: the error behind a low pass at it, which is a quarter of a period late there, is
 * taken from the command. Where the loop is later, so many ticks in all, a band pass at the same frequency leads by as much. */
static void damp(ts_controller *c, ts_real frequency, int ticks)
{
    ts_real g = ts_tangent(TS_PI * within(frequency, 0, HIGHEST_DAMPED)), square = g * g, all = 1 + g * BROAD + square;
    ts_real cosine = (1 - square) / (1 + square), sine = 2 * g / (1 + square), low = 1, band = 0; /* of the angle of a tick, of them all */
    for (int i = 0; i < ticks; i++) {
        ts_real before = low;
        low = low * cosine - band * sine;
        band = band * cosine + before * sine;
    }
    ts_real share = frequency > HIGHEST_DAMPED ? 0 : frequency > STIFFEST ? DAMPS * STIFFEST / frequency : DAMPS;
    low *= -share * BROAD * square / all;
    band *= -share * BROAD * g / all;
    const ts_real filter[5] = {low + band, 2 * low, low - band, 2 * (square - 1) / all, (1 - g * BROAD + square) / all};
    memcpy(c->feedback.damping, filter, sizeof filter);
}

/* The first tick of the strains that a stage knows. */
static uint64_t first_strain(const ts_controller *c)
{
    uint64_t now = c->counters.commands, first = c->lagged.ticks < LATE ? 0 : c->lagged.ticks - LATE;
    return first + TS_HISTORY < now ? now - TS_HISTORY : first;
}

/* The last strains, and the weights that give them, with this gain and offset, um; the strains also with a weight of the lag, s. */
static void restate(ts_controller *c, ts_real gain, ts_real offset, ts_real lag)
{
    uint64_t now = c->counters.commands;
    for (uint64_t k = first_strain(c); k < now; k++) {
        ts_real *strain = &c->dynamics.strain[k % TS_HISTORY];
        *strain = gain * *strain + offset + lag * c->motion[k % TS_HISTORY].zdot_d;
    }
    for (int i = 0; i < c->parameters; i++) c->w[i] = within(gain * c->w[i], -TS_LARGEST, TS_LARGEST);
    ts_move_offset(c, offset);
}

/* The terms that a stage of this frequency, cycles per tick, has in itself, but for what it misses: a lag, s, inertia, and rates. */
static void separate_terms(ts_controller *c, ts_real frequency, ts_real left)
{
    const ts_settings *s = c->settings;
    int place = c->of_plays + s->terms[TS_CREEP];
    ts_real time = s->oscillation.tick / (2 * TS_PI * frequency), inertia = FOUND_INERTIA * (time * time);
    ts_real lag = FOUND_LAG * time + (frequency > STIFF ? s->oscillation.tick : 0);
    if (s->terms[TS_LAG] > 0) put_weight(c, place++, left, lag * lag + left * left);
    if (s->terms[TS_INERTIA] > 0) put_weight(c, place, 0, inertia * inertia);
    for (int i = 0, at = 0; i < s->plays; i++, at++)
        if (s->rate_dependent[i]) {
            at++;
            put_weight(c, at, 0, AS_GOOD_AS_NONE * s->prior[ts_prior_entries(s, at + 1) - 1]);
        }
}

/* From now on the stage is between hysteresis and sensor; it rings by so much, um. Lag and inertia are in it, but for what it
 * misses, and so is what the rate weights have learned. What the last window has `shown` that the weights miss beside it is in
 * them from now on; NULL: nothing. */
void ts_adopt_stage(ts_controller *c, ts_real frequency, ts_real ringing, const ts_candidate *shown)
{
    const ts_settings *s = c->settings;
    ts_kalman *k = &c->law.kalman;
    ts_dynamics_state *d = &c->dynamics;
    bool again = c->found.known;
    if (!dynamics_of(c)->known) d->ticks = c->lagged.ticks;
    int before = again ? c->found.dead : 1;
    ts_real slow = again ? 0 : lag_of_amplifier(c, frequency), kept = again ? c->found.amplifier : 0, left = 0;
    int dead = slow > 0 ? 1 : dead_time(c, frequency, before);
    ts_make_dynamics(&c->found, frequency, s->oscillation.tick, dead);
    c->found.amplifier = kept;
    if (shown != NULL) left = shown->lag + (ts_real)dead * s->oscillation.tick;
    else if (slow > 0 && s->terms[TS_LAG] > 0) left = c->w[ts_column(s, TS_LAG)];
    if (shown != NULL) restate(c, 1 + shown->gain, shown->offset, left);
    else if (slow > 0) restate(c, 1, 0, left);
    if (slow > 0) begin_amplifier(c, slow);
    left = within(left + slow * s->oscillation.tick, -TS_LARGEST, TS_LARGEST);
    d->started = d->stands = false;
    d->innovation[0] = d->innovation[1] = 0;
    for (int i = 0; i < 2; i++) /* it rings on */
        d->section[0][i] = d->z[i] - c->found.direct[0] * strain_of(c, c->found.dead + 1 + i);
    ts_real corner = 2 * TS_PI * FOUND_FILTER * frequency;
    k->filter = corner / (1 + corner);
    k->disturbance = k->caution = 0;
    c->stage.smoothing = s->smoothing;
    if (c->stage.smoothing < 1 / (1 + frequency)) c->stage.smoothing = 1 / (1 + frequency);
    c->stage.inertia = 0;
    separate_terms(c, frequency, left);
    k->started = c->ringing.started = false;
    damp(c, frequency, dead + c->answered);
    ts_look_ahead_anew(c);
    ts_keep_command(c);
    ts_begin_growth(c, !again);
    if (!again) {
        memset(c->feedback.damped, 0, sizeof c->feedback.damped);
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
    ts_rest_sections(c, strain_of(c, g->dead + 1));
    for (int i = 0; i < g->modes; i++) {
        const ts_real *q = g->mode[i];
        d->mode[i][1] = (q[2] - q[4]) * d->z[0];
        d->mode[i][0] = (q[1] - q[3]) * d->z[0] + d->mode[i][1];
    }
    d->innovation[0] = d->innovation[1] = 0;
    d->started = d->stands = c->law.kalman.started = false;
}

/* The stage according to the settings. */
void ts_forget_stage(ts_controller *c)
{
    const ts_settings *s = c->settings;
    c->stage.smoothing = s->smoothing;
    if (s->law != TS_LAW_KALMAN) return;
    bool ends = c->found.known, returns = ends && s->dynamics.known;
    ts_end_amplifier(c);
    c->found.known = false;
    if (ends) ts_end_growth(c);
    if (returns) return_to_given(c);
    c->stage.resonance = s->resonance;
    ts_resonance_look(&c->resonance, s->resonance);
    c->stage.inertia = inertia_of(s, s->resonance);
    c->law.kalman.filter = s->kalman.filter;
    if (ends) ts_look_ahead_anew(c);
}

/* It was not that: the stage is that of the settings, or the resonance alone is known, as before. */
void ts_give_up_stage(ts_controller *c)
{
    if (!c->found.known) return;
    c->stage.trial = false;
    c->stage.failed = true;
    c->stage.given_up = c->stage.resonance;
    c->resonance.windows = 0;
    if (!c->settings->dynamics.known) {
        ts_end_amplifier(c);
        c->found.known = false;
        ts_end_growth(c);
        c->resonance.lag += (ts_real)(c->found.dead - 1);
        c->resonance.ticks = 0;
        ts_adopt_resonance(c, c->stage.resonance, 1);
        ts_look_ahead_anew(c);
        return;
    }
    ts_forget_stage(c);
    ts_keep_command(c);
}

/* Whether the stage of the model is the one that the measurements show. Where it is near, it is moved there. */
bool ts_stage_is_shown(ts_controller *c)
{
    const ts_resonance *r = &c->resonance;
    if (!c->found.known) return false;
    if (!(r->known > 0) || r->variance > CERTAIN * CERTAIN) return c->settings->resonance > 0 && c->guard.kept; /* nothing shows another one */
    ts_real moved = r->known / c->stage.resonance - 1;
    if (moved * moved > FURTHER * FURTHER) return false;
    if (moved * moved > MOVED * MOVED) {
        c->stage.resonance = r->known;
        ts_adopt_stage(c, r->known, 0, NULL);
    }
    return true;
}

/* Mean square of an error that may be noise, um^2. What the model misses is looked for, so it is no noise. */
static ts_real noisy(const ts_controller *c)
{
    ts_real sigma = c->law.kalman.sigma, noise = sigma < c->resolution ? c->resolution : sigma;
    return NOISY * noise * noise;
}

/* Whether the resonance of the stage is that of the settings: nothing has shown it. */
static bool is_assumed(const ts_controller *c)
{
    return !(c->stage.resonance < c->settings->resonance || c->stage.resonance > c->settings->resonance);
}

/* Whether a stage may be put into the model now: the last strains are known, and the sensor is not late. */
static bool may_have_stage(const ts_controller *c)
{
    const ts_sensor *s = &c->settings->sensor;
    if (c->hold || c->stage.rest > 0) return false;
    return !(s->ticks > 0 || s->share > 0 || s->lag > 0 || c->lagged.ticks < 8);
}

/* Mean square of an error that is a burst, um^2. */
static ts_real burst_of(const ts_controller *c)
{
    ts_real error = BURSTS * ts_guard_range(&c->guard, &c->settings->guard);
    return error * error;
}

/* Whether what is shown is so far above the resonance of the stage that was found, or of the settings, that it may be the second mode, and
 * explains no burst. */
static bool may_be_second(const ts_controller *c)
{
    const ts_settings *s = c->settings;
    const ts_resonance *r = &c->resonance;
    ts_real first = c->found.known ? c->stage.resonance : s->resonance;
    if (s->dynamics.known || !(first > 0) || !(r->known > MAY_BE_SECOND * first)) return false;
    return !(r->power > burst_of(c) && r->driven > DRIVEN);
}

/* Whether the stage that was found answers ticks later, or sooner, than in the model, which is then as wrong as with another resonance. */
static bool is_late(const ts_controller *c)
{
    const ts_resonance *r = &c->resonance;
    ts_real moved = r->known / c->stage.resonance - 1, lag = size_of(r->lag);
    if (c->settings->dynamics.known || r->windows < 2 || !(moved * moved < FURTHER * FURTHER)) return false;
    return lag > WHOLE && lag * 2 * TS_PI * r->known > TURNED && shown_dead(r, c->found.dead) != c->found.dead;
}

/* Whether the last window has shown what the weights miss beside the stage that is put into the model: in a slow motion a load does. */
static bool shows_rest(const ts_controller *c)
{
    ts_real shown = c->candidate.shown / c->stage.resonance - 1;
    return !c->found.known && c->settings->terms[TS_LAG] > 0 && size_of(shown) < TRIED && c->resonance.motion > SLOWEST * c->stage.resonance;
}

/* Whether the stage is put into the model, or its resonance or dead time there replaced: the motion is fast enough that it matters, and the error
 * larger than noise; or it rings. */
static bool matters(const ts_controller *c)
{
    const ts_resonance *r = &c->resonance;
    if (!may_have_stage(c) || may_be_second(c)) return false;
    bool assumed = c->found.known && is_assumed(c);
    bool bursts = !c->found.known && r->windows > 0 && r->power > burst_of(c);
    if (bursts && !(r->driven > DRIVEN)) return false;
    bool sensitive = r->sensitivity > MOST_SENSITIVE && r->variance > KNOWN * KNOWN;
    bool doubtful = c->stage.failed || (c->guard.kept && !bursts && sensitive);
    ts_real certain = doubtful || dynamics_of(c)->known ? CERTAIN : CERTAIN_AT_FIRST;
    if (!(ts_resonance_suffices(r) || bursts) || (r->variance > certain * certain && !assumed)) return false;
    if (!c->found.known && size_of(r->centre / r->known - 1) > AGREES) return false; /* windows that walk are not noise about it */
    bool unknown = !c->found.known && !is_given(c), again = size_of(r->known - c->stage.given_up) < TRIED * c->stage.given_up;
    if (unknown && again && !bursts) return false;
    if (c->found.known) {
        ts_real moved = r->known / c->stage.resonance - 1;
        if (is_late(c)) return true;
        ts_real seen = SEEN * ts_guard_range(&c->guard, &c->settings->guard);
        if (c->guard.kept && r->power < seen * seen) return false;
        bool anywhere = assumed || c->stage.trial; /* it has never been better than none */
        return moved * moved > MOVED * MOVED && (anywhere || moved * moved < FURTHER * FURTHER) && moved * moved > 4 * r->variance;
    }
    if (is_given(c)) {
        const ts_guard *g = &c->guard;
        bool failing = g->held > 0 || g->wait > TS_FIRST_WAIT;
        ts_real away = r->known / c->settings->dynamics.first - 1, least = failing ? ELSEWHERE : ANOTHER;
        ts_real share = away > MAY_BE_SECOND - 1 ? OF_SECOND : DOUBT, large = share * ts_guard_range(g, &c->settings->guard);
        if (!failing && !bursts && c->stage.doubted < LASTS) return false;
        return away * away > least * least && r->power > large * large && r->driven > TS_DRIVEN_ALONE;
    }
    ts_real least = noisy(c), large = DOUBT * ts_guard_range(&c->guard, &c->settings->guard);
    bool fast = r->motion > SLOWEST * r->known, worse = size_of(c->candidate.worse / r->known - 1) < TRIED;
    if (fast && worse && !bursts) return false;
    if (doubtful && c->guard.kept && least < large * large) least = large * large;
    if (fast && r->power > least) return true;
    if (doubtful || (c->guard.kept && r->sensitivity > STANDS_ALONE)) return false;
    ts_real rings = SHAKEN * ts_guard_range(&c->guard, &c->settings->guard), ringing = ts_resonance_ringing(r);
    return ringing > rings * rings && ringing * (ts_real)r->window > BY_CHANCE * noisy(c);
}

/* The last strains as the model has them when lag and inertia are in the stage: weights that were in their place would be a step of the
 * strain, at which the stage of the model rings. */
static void forget_lag(ts_controller *c)
{
    const int *n = c->settings->terms;
    int place = c->of_plays + n[TS_CREEP];
    ts_real lag = n[TS_LAG] > 0 ? c->w[place] : 0, inertia = n[TS_INERTIA] > 0 ? c->w[place + n[TS_LAG]] : 0;
    uint64_t now = c->counters.commands;
    for (uint64_t k = first_strain(c); k < now; k++) {
        const ts_motion *d = &c->motion[k % TS_HISTORY];
        c->dynamics.strain[k % TS_HISTORY] -= lag * d->zdot_d + inertia * d->zddot_d;
    }
}

/* Weights that are expected of the plays that stand for all of them, um/V: the first ones, with the gain that was learned. Each play
 * counts for the nearest of them. False: that gain is not one of this actuator. */
static bool expected_of_plays(const ts_controller *c, ts_real *expected)
{
    const ts_settings *s = c->settings;
    const ts_real *first = c->kept.first;
    ts_real before = 0, now = 0;
    int last = s->plays > 1 ? s->plays - 1 : 1;
    memset(expected, 0, sizeof(ts_real) * TS_SHOWN);
    for (int i = 0, at = 0; i < s->plays; at += 1 + s->rate_dependent[i++]) {
        expected[(i * (TS_SHOWN - 1) + last / 2) / last] += first[at];
        before += first[at];
        now += c->w[at];
    }
    if (!(now * MOST_GAINED > before && now < MOST_GAINED * before)) return false;
    for (int i = 0; i < TS_SHOWN; i++) expected[i] *= now / before;
    return true;
}

/* The highest frequency of a first resonance, cycles per tick. Where the stage of the model has long been good, what is shown further
 * above is its second mode. */
static ts_real highest_first(const ts_controller *c, bool staged)
{
    bool good = staged && c->found.known && c->guard.settled && !c->guard.lost && !c->stage.trial;
    return good ? (1 + FURTHER) * c->stage.resonance : TS_HIGHEST_RESONANCE;
}

/* Whether the law begins with an identified model, whose lag is that of the stage, too: terms beside plays and lag have weights. */
bool ts_is_identified(const ts_controller *c)
{
    const ts_settings *s = c->settings;
    int lag = s->terms[TS_LAG] > 0 ? c->of_plays + s->terms[TS_CREEP] : -1;
    for (int i = c->of_plays; i < c->parameters; i++)
        if (i != lag && (s->initial_weights[i] < 0 || s->initial_weights[i] > 0)) return true;
    return false;
}

/* Mean square of an error from which on a tone is no load, um^2. With a trim it may be one that the trim sustains. */
static ts_real loudest_load(const ts_controller *c, ts_real range)
{
    if (c->settings->trim > 0) return 0;
    return is_given(c) ? LOUD * LOUD * (range * range) : TS_LARGEST * TS_LARGEST;
}

/* One tick of the estimate: the plays of a tick before the measurement, which is about its dead time. */
void ts_watch_resonance(ts_controller *c, ts_real z, ts_real error, const ts_motion *d, bool staged)
{
    const ts_settings *s = c->settings;
    ts_resonance *r = &c->resonance;
    ts_real x[TS_SHOWN + 1], now[TS_SHOWN], expected[TS_SHOWN];
    if (is_given(c) && !(c->guard.error > DOUBT)) { /* no reason to look for another */
        r->ticks = 0;
        c->law.kalman.load = 0;
        return;
    }
    for (int i = 0; i < TS_SHOWN; i++) now[i] = c->lagged.play[(i * (s->plays - 1) + (TS_SHOWN - 1) / 2) / (TS_SHOWN - 1)];
    memcpy(x, staged ? now : c->shown, sizeof now);
    memcpy(c->shown, now, sizeof now);
    x[TS_SHOWN] = z;
    bool good = c->guard.kept && !staged && !s->dynamics.known; /* a stage that is wrong would lose what was learned */
    ts_real whole = ts_guard_range(&c->guard, &s->guard);
    bool ends = !staged && ts_resonance_ends(r, noisy(c), whole * whole); /* with a stage in the model weights may go with it */
    const ts_search search = {
        .range = good ? whole : 0,
        .highest = highest_first(c, staged),
        .burst = c->found.known ? 0 : burst_of(c),
        .loudest = loudest_load(c, whole),
        .steady = is_given(c) && c->guard.error < NOT_URGENT ? STEADY_BESIDE_GIVEN : TS_STEADY_TONE,
        .driven = dynamics_of(c)->known ? 1 : TS_DRIVEN_ALONE,
        .least = ts_power_of_hum(c),
        .noise = s->resonance > 0 ? 0 : c->law.kalman.sigma * c->law.kalman.sigma, /* where f0 is given windows begin about it */
        .expected = ends && expected_of_plays(c, expected) ? expected : NULL,
    };
    bool unknown = !staged && !is_given(c);
    if (unknown) ts_candidate_tick(c, z, d->zdot_d);
    bool known = ts_resonance_tick(r, s->oscillation.tick, x, error, d->zdot_d, d->zdot_d - c->rate, &search);
    c->rate = d->zdot_d;
    if (unknown && r->ticks == 0) ts_candidate_end(c);
    if (r->ticks == 0) c->law.kalman.load = r->load > 0 ? LOAD_COUNTS * ts_kalman_noise_of_sine(&c->law.kalman, r->load, r->load_at) : 0;
    bool assumes = s->resonance > 0 && !dynamics_of(c)->known && !c->stage.failed && !ts_is_identified(c) && may_have_stage(c);
    if (!assumes && (!known || !matters(c))) return;
    c->stage.resonance = assumes ? s->resonance : r->known;
    c->guard.settled = c->guard.settled && c->guard.lost; /* else it was no wrong sensor: there is nothing to return to */
    forget_lag(c);
    bool takes = !assumes && shows_rest(c);
    if (!c->found.known && (!assumes || c->guard.kept)) doubt_learned(c, c->stage.resonance); /* at the start nothing is learned */
    ts_adopt_stage(c, c->stage.resonance, assumes ? 0 : root_of(r->power), takes ? &c->candidate : NULL);
    if (assumes && !c->guard.kept) { /* at the start it rests where it is, and learning does not wait */
        c->dynamics.stands = true;
        ts_kalman_start_filters(&c->law.kalman, c->parameters);
    }
    if (!assumes && search.burst > 0 && r->power > search.burst) c->stage.before.growth.late = 1; /* a burst excites the second mode, too */
}
