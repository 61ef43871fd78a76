#include "lanes.h"

#include <string.h>

#define SEARCH_FROM ((ts_real)0.15) /* cycles per tick: where the search begins, */
#define OF_MOTION 2                 /* its end is at TS_LOWEST_RESONANCE, or at so many times the motion's frequency, */
#define AGAIN_FROM ((ts_real)0.36)  /* cycles per tick: and where every second one begins after that; */
#define NEXT ((ts_real)0.6)         /* of a centre: the next one, where there was no resonance */
#define POINTS ((ts_real)0.05)      /* standard deviation of an estimate, over it, that says where the next window is */
#define PASSES ((ts_real)0.35)      /* of the centre: corner of the filter that takes the motion away */
#define SHARP ((ts_real)1.4)        /* twice the damping of that filter, */
#define ROUND 1                     /* and of the one behind it, which takes noise away */
#define SETTLED_IN 3                   /* periods of the centre until both have settled, */
#define WINDOW 20                    /* and of a window, */
#define SHORTEST ((ts_real)0.06)    /* s: but no shorter, */
#define SUDDEN 4                    /* times the mean square of a burst: an error with which one begins */
#define QUIET 25                    /* times the mean square at rest is less than that of a burst */
#define LONGEST ((ts_real)1e8)      /* ticks: and no longer */
#define RIDGE ((ts_real)1e-4)       /* of the largest of the plays: how well each of them is known before */
#define LAG_STEPS 4                 /* of Newton's method: enough for a lag up to 1 / w0 */
#define COARSE 4                    /* plays, those of the smallest thresholds, with which the resonance is found once more */
#define COSTS ((ts_real)0.5)        /* of the range: the error of a stage that is wrong by itself, in a motion as fast as it is */
#define SHOWN_WITHIN ((ts_real)0.02) /* standard deviation of an estimate, over it, that shows a resonance, */
#define EXPECTED_WITHIN ((ts_real)0.03) /* where the weights of the plays are expected, */
#define ABOUT ((ts_real)0.04)       /* and where it is about its centre, and no stage is in the model */
#define EXPLAIN ((ts_real)0.5)      /* share of the plays, there: what our voltage does not drive is noise */
#define SHOWS ((ts_real)0.5)        /* of the error of plays alone: a resonance leaves less */
#define RINGS_ALONE ((ts_real)0.45)  /* and what rings without our voltage: white noise leaves 0.48 to 0.65 */
#define NEAREST ((ts_real)0.6)      /* of the centre: bounds of an estimate in that window */
#define FURTHEST ((ts_real)1.4)
#define AGREE ((ts_real)1.05)       /* centre and estimate */
#define LEAST ((ts_real)0.005)      /* the smallest error of an estimate, over it */
#define LEAST_IN_BURST ((ts_real)0.01) /* that of one that need not be near its centre, in a burst */
#define WALK ((ts_real)0.002)       /* how far the resonance moves in a window */
#define OF_FOURTH ((ts_real)6.675)   /* mean magnitude of the fourth difference of white noise, over its standard deviation */
#define HALVINGS 12                 /* of the noise of a measurement, until what is measured has it, */
#define CORRECTED ((ts_real)0.5)    /* and of how far that moves the resonance: what counts as an error */
#define JUMPS 3                     /* standard deviations of a difference */
#define MOST_WINDOWS 1000           /* that are counted */
#define EXPECTED ((ts_real)0.1)     /* of the gain of all plays: how far a weight is from the one that is expected, */
#define EXPECTS 5                   /* where the error of a window is so many times its residual */
#define SAME ((ts_real)0.05)        /* of what a load shows: what is known so near to it was of the load, too */
#define STANDS ((ts_real)0.1)       /* of a resonance that is shown so, or about its centre: where fewer plays move it further there is none */

/* Largest standard deviation of an estimate, over it, and of one about its centre, how many of these its error is, and the noise of
 * a measurement, um^2. */
typedef struct {
    ts_real sure, about, trust, noise;
} ts_confidence;

/* What a window shows. */
typedef struct {
    ts_real f0;                     /* cycles per tick; 0: none */
    ts_real variance;               /* square of its error, over it */
    ts_real lag, first_order, sensitivity;
    ts_real left;                   /* sum of squares of the residual */
    ts_real points;                 /* cycles per tick: to a resonance that is further away or less certain; 0: to none */
} ts_window;

enum { BAND = TS_SHOWN, HIGH, THIRD, LOW }; /* of the measurement, its derivatives and itself: places behind the plays */

/* By the series of sine and cosine. */
ts_real ts_tangent(ts_real x)
{
    ts_real sine = 1, cosine = 1, x2 = x * x;
    for (int k = 9; k > 0; k--) {
        sine = 1 - x2 * sine / (ts_real)(2 * k * (2 * k + 1));
        cosine = 1 - x2 * cosine / (ts_real)(2 * k * (2 * k - 1));
    }
    return x * sine / cosine;
}

/* By the series of a quarter of the angle. */
ts_real ts_arctangent(ts_real x)
{
    for (int i = 0; i < 2; i++) x /= 1 + root_of(1 + x * x);
    ts_real sum = 0, x2 = x * x;
    for (int k = 9; k >= 0; k--) sum = 1 / (ts_real)(2 * k + 1) - x2 * sum;
    return 4 * (x * sum);
}

/* The dead time that turns w0 as far as a lag does, in ticks. */
static ts_real dead_time_of(ts_real lag, ts_real w0)
{
    return lag > 0 ? ts_arctangent(w0 * lag) / w0 : lag < 0 ? -ts_arctangent(-w0 * lag) / w0 : 0;
}

static void filter_at(ts_real *a, ts_real frequency, ts_real k)
{
    ts_real g = ts_tangent(TS_PI * frequency);
    a[0] = 1 / (1 + g * (g + k));
    a[1] = g * a[0];
    a[2] = g * a[1];
}

/* One tick of a second-order filter in the form of two integrators: band and low pass. The high pass is x - k band - low. */
static void pass_two(const ts_real *a, ts_real *state, ts_real x, ts_real *band, ts_real *low)
{
    ts_real v = x - state[1];
    *band = a[0] * state[0] + a[1] * v;
    *low = state[1] + a[1] * state[0] + a[2] * v;
    state[0] = 2 * *band - state[0];
    state[1] = 2 * *low - state[1];
}

/* One tick of a first-order low pass in the form of an integrator. */
static ts_real pass_one(ts_real share, ts_real *state, ts_real x)
{
    ts_real v = share * (x - *state), low = *state + v;
    *state = low + v;
    return low;
}

static void begin_band(ts_resonance *r, ts_real tick, const ts_real *x)
{
    if (!(r->centre > 0)) r->centre = SEARCH_FROM;
    ts_real settles = SETTLED_IN / r->centre, lasts = WINDOW / r->centre, shortest = SHORTEST / tick;
    if (lasts < shortest) lasts = shortest;
    r->settling = (int)(settles < LONGEST ? settles : LONGEST);
    r->window = (int)(lasts < LONGEST ? lasts : LONGEST);
    filter_at(r->motion_filter, PASSES * r->centre, SHARP);
    filter_at(r->noise_filter, r->centre, ROUND);
    ts_real g = ts_tangent(TS_PI * r->centre);
    r->last_filter = g / (1 + g);
    memcpy(r->first, x, sizeof r->first);
    memset(r->state, 0, sizeof r->state);
    memset(r->last, 0, sizeof r->last);
    memset(r->sum, 0, sizeof r->sum);
    memset(r->before, 0, sizeof r->before);
    memset(r->of_noise, 0, sizeof r->of_noise);
    memset(r->impulse, 0, sizeof r->impulse);
    memset(r->last_impulse, 0, sizeof r->last_impulse);
    r->speed = r->change = r->error = r->fourth = 0;
    ts_tone_begin(&r->tone, r->centre);
}

/* What is measured behind the band: its derivatives, and itself. */
static void pass_measurement(const ts_resonance *r, ts_real *state, ts_real *last, ts_real x, ts_real *v)
{
    ts_real band, low, high;
    pass_two(r->motion_filter, state, x, &band, &low);
    high = x - SHARP * band - low;
    pass_two(r->noise_filter, state + 2, high, &band, &low);
    ts_real second = high - ROUND * band - low;
    v[0] = pass_one(r->last_filter, &last[0], band);
    v[1] = pass_one(r->last_filter, &last[1], second);
    v[2] = second - v[1];
    v[3] = pass_one(r->last_filter, &last[2], low);
}

/* What noise makes of the products: those of the response to a single sample, which is over when the band has settled. */
static void count_noise(ts_resonance *r)
{
    ts_real v[TS_MEASURED], *sum = r->of_noise;
    pass_measurement(r, r->impulse, r->last_impulse, r->ticks == 0 ? 1 : 0, v);
    for (int i = 0; i < TS_MEASURED; i++)
        for (int j = 0; j <= i; j++) *sum++ += v[i] * v[j];
}

static void count_tick(ts_resonance *r, const ts_real *x, ts_real error)
{
    ts_real v[TS_RESONANCE] = {0};
    for (int i = 0; i < TS_SHOWN; i++) {
        ts_real band, low, high, *state = r->state[i];
        pass_two(r->motion_filter, state, x[i] - r->first[i], &band, &low);
        high = x[i] - r->first[i] - SHARP * band - low;
        pass_two(r->noise_filter, state + 2, high, &band, &low);
        v[i] = pass_one(r->last_filter, &r->last[i], low);
    }
    ts_real z = x[TS_SHOWN] - r->first[TS_SHOWN], *before = r->before;
    ts_real fourth = z - 4 * before[0] + 6 * before[1] - 4 * before[2] + before[3];
    memmove(before + 1, before, 3 * sizeof *before);
    before[0] = z;
    pass_measurement(r, r->state[TS_SHOWN], r->last + TS_SHOWN, z, v + BAND);
    if (r->ticks < r->settling) {
        count_noise(r);
        return;
    }
    ts_real *sum = r->sum;
    TS_UNROLLED_WHOLE
    for (int i = 0; i <= LOW; i++) {
        TS_UNROLLED_WHOLE
        for (int j = 0; j <= i; j++) *sum++ += v[i] * v[j];
    }
    r->error += error * error;
    r->fourth += size_of(fourth);
}

/* Eliminates the unknowns from `begin` to before `end`; returns whether all of them could be. */
static bool eliminate(ts_real (*N)[TS_RESONANCE], int begin, int end)
{
    for (int k = begin; k < end; k++) {
        if (!(N[k][k] > 0)) return false;
        for (int i = k + 1; i <= LOW; i++) {
            ts_real factor = N[i][k] / N[k][k];
            for (int j = k + 1; j <= i; j++) N[i][j] -= factor * N[j][k];
        }
    }
    return true;
}

static void sums_of(const ts_resonance *r, ts_real (*N)[TS_RESONANCE])
{
    for (int i = 0; i <= LOW; i++) memcpy(N[i], r->sum + TS_PACKED(i), sizeof(ts_real) * (size_t)(i + 1));
}

/* The same, where the plays are known as well as before. */
static void sums_with_ridge(const ts_resonance *r, ts_real (*N)[TS_RESONANCE])
{
    ts_real largest = 0;
    sums_of(r, N);
    for (int i = 0; i < TS_SHOWN; i++) largest = N[i][i] > largest ? N[i][i] : largest;
    for (int i = 0; i < TS_SHOWN; i++) N[i][i] += RIDGE * largest;
}

/* The same, where the weights of the plays are known: those that are expected, um/V, as well as their gain is, and as the residual of
 * plays that are free allows. */
static void sums_with_expected(const ts_resonance *r, const ts_real *expected, ts_real left, ts_real (*N)[TS_RESONANCE])
{
    ts_real gain = 0, by[TS_RESONANCE] = {0};
    sums_of(r, N);
    for (int i = 0; i < TS_SHOWN; i++) gain += expected[i];
    for (int i = 0; i <= LOW; i++)
        for (int j = 0; j < TS_SHOWN; j++) by[i] += expected[j] * (j < i ? N[i][j] : N[j][i]);
    for (int i = 0; i < TS_SHOWN; i++) by[LOW] -= expected[i] * (by[i] - N[LOW][i]);
    for (int i = 0; i < LOW; i++) N[LOW][i] -= by[i];
    N[LOW][LOW] -= by[LOW];
    ts_real spread = EXPECTED / EXPECTS * gain, ridge = left / ((ts_real)r->window * (spread * spread));
    for (int i = 0; i < TS_SHOWN; i++) N[i][i] += ridge;
}

/* How much smaller `left` is than the residual of an equation without plays, that of ringing alone. */
static ts_real share_of_plays(const ts_resonance *r, ts_real left)
{
    ts_real N[TS_RESONANCE][TS_RESONANCE];
    sums_of(r, N);
    if (!eliminate(N, BAND, LOW)) return 0;
    ts_real alone = N[LOW][LOW];
    return alone > left ? 1 - left / alone : 0;
}

/* The lag t of 1 + c1 s + c2 s^2 + c3 s^3 = (1 + t s) (1 + (c1 - t) s + ratio s^2), by Newton's method from that of a large
 * inertia; returns the ratio, and its derivatives. 0: there is none. */
static ts_real without_lag(const ts_real *c, ts_real *lag, ts_real *derivative)
{
    ts_real t = c[2] / c[1], slope = c[1];
    for (int i = 0; i < LAG_STEPS; i++) {
        slope = (3 * t - 2 * c[0]) * t + c[1];
        if (!(slope > 0)) return 0;
        t -= (((t - c[0]) * t + c[1]) * t - c[2]) / slope;
    }
    ts_real of_lag = (2 * t - c[0]) / slope;
    derivative[0] = of_lag * (t * t) - t;
    derivative[1] = 1 - of_lag * t;
    derivative[2] = of_lag;
    *lag = t;
    return c[1] - t * (c[0] - t);
}

/* Whether the derivatives can be eliminated, behind the plays: their coefficients c. */
static bool solve(ts_real (*N)[TS_RESONANCE], ts_real *c)
{
    if (!eliminate(N, BAND, LOW)) return false;
    c[2] = -N[LOW][THIRD] / N[THIRD][THIRD];
    c[1] = -(N[LOW][HIGH] + c[2] * N[THIRD][HIGH]) / N[HIGH][HIGH];
    c[0] = -(N[LOW][BAND] + c[2] * N[THIRD][BAND] + c[1] * N[HIGH][BAND]) / N[BAND][BAND];
    return c[1] > 0;
}

/* The coefficients c without so much noise of a measurement, um^2, in the products of what is measured; false: they have less. */
static bool solve_without(const ts_resonance *r, const ts_real *products, ts_real noise, ts_real *c)
{
    ts_real M[TS_RESONANCE][TS_RESONANCE] = {{0}}, all = noise * (ts_real)r->window;
    const ts_real *of_noise = r->of_noise;
    for (int i = BAND; i <= LOW; i++)
        for (int j = BAND; j <= i; j++) M[i][j] = *products++ - all * *of_noise++;
    return solve(M, c) && M[LOW][LOW] > 0;
}

/* The same without noise of a measurement, which behind the band is like ringing at its centre: the more of it, the nearer to that is
 * the estimate. No more than `most`, um^2, or the residual `left` shows, and half of what the products can have: near that the
 * coefficients are anything. */
static bool without_noise(const ts_resonance *r, const ts_real *products, ts_real most, ts_real left, ts_real *c)
{
    const ts_real v[TS_MEASURED] = {c[0], c[1], c[2], 1}, *of_noise = r->of_noise;
    ts_real of_one = 0, seen = r->fourth / (OF_FOURTH * (ts_real)r->window), noise = seen * seen < most ? seen * seen : most;
    for (int i = 0; i < TS_MEASURED; i++)
        for (int j = 0; j <= i; j++) of_one += (ts_real)(j < i ? 2 : 1) * (v[i] * v[j]) * *of_noise++;
    of_one *= (ts_real)r->window;
    if (left < noise * of_one) noise = left / of_one;
    for (int i = 0; i < HALVINGS && !solve_without(r, products, noise, c); i++) noise /= 2;
    return solve_without(r, products, noise / 2, c);
}

/* How far the resonance moves, over it, where the hysteresis is that of fewer plays, which N is without; at most 1. */
static ts_real sensitivity_of(ts_real (*N)[TS_RESONANCE], ts_real ratio)
{
    ts_real c[3], derivative[3], lag, coarse = solve(N, c) ? without_lag(c, &lag, derivative) : 0;
    ts_real moved = coarse > 0 ? size_of(root_of(ratio / coarse) - 1) : 1;
    return moved < 1 ? moved : 1;
}

/* Whether a window about this frequency is the present one. */
static bool is_about(const ts_resonance *r, ts_real frequency)
{
    return r->centre < AGREE * frequency && frequency < AGREE * r->centre;
}

/* The resonance of (centre / f0)^2, of their tangents, cycles per tick. */
static ts_real resonance_of(const ts_resonance *r, ts_real ratio)
{
    return ts_arctangent(ts_tangent(TS_PI * r->centre) / root_of(ratio)) / TS_PI;
}

/* Resonance and lag as these coefficients have them, where it is one of the search. Returns its change, as far as it is an error. */
static ts_real correct(const ts_resonance *r, const ts_real *c, ts_real lowest, ts_real *f0, ts_real *lag)
{
    ts_real derivative[3], t = 0, ratio = without_lag(c, &t, derivative), f = ratio > 0 ? resonance_of(r, ratio) : 0;
    if (!(f > lowest && f < TS_HIGHEST_RESONANCE)) return 0;
    ts_real change = CORRECTED * (f / *f0 - 1);
    *f0 = f;
    *lag = t;
    return change;
}

/* What sums of products show. */
static ts_window shown_by(ts_resonance *r, ts_real (*N)[TS_RESONANCE], ts_real lowest, ts_confidence as)
{
    ts_window w = {0};
    ts_real fewer[TS_RESONANCE][TS_RESONANCE], measured[TS_PACKED(TS_MEASURED)], c[3], derivative[3] = {0};
    if (!eliminate(N, 0, COARSE)) return w;
    for (int i = BAND; i <= LOW; i++) memcpy(fewer[i] + BAND, N[i] + BAND, sizeof(ts_real) * (size_t)(i + 1 - BAND));
    if (!eliminate(N, COARSE, BAND)) return w;
    for (int i = 0; i < TS_MEASURED; i++) memcpy(measured + TS_PACKED(i), N[BAND + i] + BAND, sizeof(ts_real) * (size_t)(i + 1));
    ts_real plays = N[LOW][LOW];
    bool solved = solve(N, c);
    w.left = N[LOW][LOW];
    if (!solved) return w;
    ts_real ratio = without_lag(c, &w.lag, derivative); /* (centre / f0)^2, of their tangents */
    if (!(ratio > 0) || !(w.left < SHOWS * plays)) return w;
    ts_real of_first = derivative[0], of_second = derivative[1] - N[HIGH][BAND] / N[BAND][BAND] * of_first;
    ts_real of_third = derivative[2] - N[THIRD][BAND] / N[BAND][BAND] * of_first - N[THIRD][HIGH] / N[HIGH][HIGH] * of_second;
    ts_real spread = of_first * of_first / N[BAND][BAND] + of_second * of_second / N[HIGH][HIGH] + of_third * of_third / N[THIRD][THIRD];
    ts_real of_ratio = w.left > 0 ? w.left * spread / (ts_real)r->window : 0;
    ts_real doubtful = 2 * POINTS * ratio;
    if (!(of_ratio < doubtful * doubtful)) return w;
    ts_real f0 = resonance_of(r, ratio), corrected = 0;
    if (!(f0 > lowest && f0 < TS_HIGHEST_RESONANCE)) return w;
    if (without_noise(r, measured, as.noise, w.left, c)) corrected = correct(r, c, lowest, &f0, &w.lag);
    w.points = f0;
    w.sensitivity = sensitivity_of(fewer, ratio);
    ts_real share = share_of_plays(r, w.left);
    bool stands = is_about(r, f0) && !(w.sensitivity > STANDS) && share > EXPLAIN;
    ts_real deviation = 2 * (stands ? as.about : as.sure) * ratio;
    if (!(of_ratio < deviation * deviation)) return w;
    w.first_order = w.lag / (2 * ts_tangent(TS_PI * r->centre));
    w.lag = dead_time_of(w.first_order, 2 * TS_PI * f0);
    w.variance = as.trust * as.trust * of_ratio / (4 * ratio * ratio) + corrected * corrected;
    r->driven = share;
    r->sensitivity = w.sensitivity;
    if (f0 > NEAREST * r->centre && f0 < FURTHEST * r->centre) w.f0 = f0;
    return w;
}

/* What the window shows with plays that are free, or else with those that are expected. */
static ts_window shown_window(ts_resonance *r, ts_real lowest, const ts_search *search)
{
    bool first = search->burst > 0 && r->speed > 0;
    const ts_confidence of_free = {SHOWN_WITHIN, first ? ABOUT : SHOWN_WITHIN, 5, search->noise};
    const ts_confidence of_expected = {EXPECTED_WITHIN, first ? ABOUT : EXPECTED_WITHIN, 3, search->noise};
    const ts_real *expected = search->expected;
    ts_real N[TS_RESONANCE][TS_RESONANCE];
    sums_with_ridge(r, N);
    ts_window of_plays = shown_by(r, N, lowest, of_free);
    if (of_plays.f0 > 0 || !expected || !(of_plays.left > 0)) return of_plays;
    sums_with_expected(r, expected, of_plays.left, N);
    ts_window w = shown_by(r, N, lowest, of_expected);
    if (w.sensitivity > STANDS) w.f0 = 0;
    w.points = of_plays.points;
    return w;
}

/* What is known of the resonance, after a window that shows one. Two windows in a row that differ from it
 * are a jump. */
static void know(ts_resonance *r, const ts_window *w)
{
    ts_real new = w->variance + LEAST * LEAST;
    r->variance += WALK * WALK;
    ts_real change = r->known > 0 ? w->f0 / r->known - 1 : 0, gain = r->variance / (r->variance + new);
    bool far = change * change > JUMPS * JUMPS * (r->variance + new);
    if (!(r->known > 0) || (far && r->strange)) {
        r->known = w->f0;
        r->lag = w->lag;
        r->first_order = w->first_order;
        r->variance = new;
        r->windows = 1;
    } else if (!far) {
        r->known *= 1 + gain * change;
        r->lag += gain * (w->lag - r->lag);
        r->first_order += gain * (w->first_order - r->first_order);
        r->variance = (1 - gain) * r->variance;
        if (r->windows < MOST_WINDOWS) r->windows++;
    }
    r->strange = far && !r->strange;
}

/* The next centre, behind a window. */
static ts_real next_centre(ts_resonance *r, const ts_window *w, ts_real lowest, const ts_search *search)
{
    bool first = search->burst > 0, about = is_about(r, r->known); /* no stage is in the model */
    ts_real below = NEXT * (first && about && r->swept > 0 ? r->swept : r->centre);
    if (w->f0 > 0) {
        r->pointed = 0;
        return w->f0;
    }
    if (!(r->speed > 0) && QUIET * r->power < search->burst) return r->centre; /* at rest nothing shows, wherever the window is */
    bool points = w->points > 0 && w->points <= search->highest && !is_about(r, w->points);
    if (points && first && r->pointed < TS_MOST_POINTED) {
        r->pointed++;
        return w->points;
    }
    if (first && r->known > lowest && !about) {
        r->swept = r->centre;
        return r->known;
    }
    if (below > lowest) return below;
    r->pointed = 0;
    r->again = !r->again;
    return r->again ? SEARCH_FROM : AGAIN_FROM;
}

/* A load that the window sees is no resonance: what the window shows near it, or points to, is not that of the stage. */
static void pass_over_load(ts_resonance *r, ts_window *w, const ts_search *search)
{
    ts_real tone = ts_tone_of_load(&r->tone, search->steady, TS_ORDERS_OF_STAGE, TS_OFF_HARMONIC_OF_STAGE);
    ts_real amplitude = ts_tone_amplitude(&r->tone), most = root_of(2 * r->power);
    if (r->load > most) r->load = most;
    if (!(tone > 0) || !(r->power < search->loudest)) return;
    /* In less than two periods of the motion its harmonics are not known. */
    bool own = r->tone.turns < 2 && r->driven > search->driven && size_of(w->f0 / tone - 1) < TS_OF_LOAD;
    if (own) return;
    if (amplitude > r->load) r->load = amplitude;
    r->load_at = tone;
    ts_real shown = w->f0 > 0 ? w->f0 : w->points;
    if (!(size_of(shown / tone - 1) < TS_OF_LOAD)) return;
    if (r->known > 0 && size_of(shown / r->known - 1) < SAME) {
        r->known = 0;
        r->windows = 0;
    }
    w->f0 = w->points = 0;
}

/* Whether this window adds to what is known. */
static bool end_band(ts_resonance *r, ts_real tick, const ts_search *search)
{
    r->motion = r->speed > 0 ? r->change / (2 * TS_PI * r->speed) : 0;
    r->power = r->error / (ts_real)r->window;
    ts_real lowest = ts_resonance_lowest(r, tick);
    ts_window w = shown_window(r, lowest, search);
    if (w.f0 > 0) {
        ts_real fast = r->motion / w.f0, cost = COSTS * search->range * w.sensitivity * (fast * fast);
        if (r->power < cost * cost) w.f0 = 0;
    }
    if (w.f0 > search->highest) w.f0 = 0;
    pass_over_load(r, &w, search);
    if (r->power < search->least) w.f0 = w.points = 0;
    ts_real f0 = w.f0, least = search->burst > 0 && r->power > search->burst ? LEAST_IN_BURST : LEAST;
    bool near = f0 > 0 && (is_about(r, f0) || w.variance < least * least);
    r->centre = next_centre(r, &w, lowest, search);
    r->ticks = 0;
    if (near) know(r, &w);
    return near;
}

ts_real ts_resonance_ringing(const ts_resonance *r)
{
    ts_real N[TS_RESONANCE][TS_RESONANCE];
    sums_with_ridge(r, N);
    if (!eliminate(N, 0, BAND)) return 0;
    ts_real plays = N[LOW][LOW];
    if (!eliminate(N, BAND, LOW) || !(r->driven > EXPLAIN || N[LOW][LOW] < RINGS_ALONE * plays)) return 0;
    return (plays - N[LOW][LOW]) / (ts_real)r->window;
}

bool ts_resonance_suffices(const ts_resonance *r)
{
    return r->windows > 1 || (r->windows > 0 && r->variance < 2 * LEAST * LEAST);
}

ts_real ts_resonance_lowest(const ts_resonance *r, ts_real tick)
{
    ts_real lowest = TS_LOWEST_RESONANCE * tick;
    return lowest > OF_MOTION * r->motion ? lowest : OF_MOTION * r->motion;
}

void ts_resonance_look(ts_resonance *r, ts_real frequency)
{
    if (is_about(r, frequency) || !(frequency > 0 && frequency < TS_HIGHEST_RESONANCE)) return;
    r->centre = frequency;
    r->ticks = 0;
}

bool ts_resonance_ends(const ts_resonance *r, ts_real above, ts_real below)
{
    bool last = r->ticks > 0 && r->ticks + 1 >= r->settling + r->window;
    return last && r->error > above * (ts_real)r->window && r->error < below * (ts_real)r->window;
}

/* Whether the error has become that of a burst in a window that lasts too long to wait for. */
static bool begins_to_burst(const ts_resonance *r, ts_real tick, ts_real error, ts_real burst)
{
    ts_real counted = (ts_real)(r->ticks - r->settling);
    bool now = counted > 0 && error * error > SUDDEN * burst && r->error < burst * counted;
    return now && WINDOW / r->centre - counted > SHORTEST / tick;
}

/* Whether the window has the periods that it needs, in a burst, which does not let it wait for more. */
static bool suffices_in_burst(const ts_resonance *r, ts_real burst)
{
    ts_real counted = (ts_real)(r->ticks - r->settling);
    return counted * r->centre > WINDOW && r->error > burst * counted;
}

bool ts_resonance_tick(ts_resonance *r, ts_real tick, const ts_real *x, ts_real error, ts_real zdot_d, ts_real change,
                       const ts_search *search)
{
    bool may_burst = r->ticks > 0 && search->burst > 0;
    if (may_burst && begins_to_burst(r, tick, error, search->burst)) {
        r->centre = SEARCH_FROM;
        r->ticks = r->pointed = 0;
    }
    bool last = may_burst && r->ticks > 0 && suffices_in_burst(r, search->burst);
    if (r->ticks == 0) begin_band(r, tick, x);
    count_tick(r, x, error);
    ts_tone_tick(&r->tone, error, zdot_d);
    r->speed += zdot_d < 0 ? -zdot_d : zdot_d;
    r->change += change < 0 ? -change : change;
    r->ticks++;
    if (last) r->window = r->ticks - r->settling;
    return r->ticks >= r->settling + r->window && end_band(r, tick, search);
}
