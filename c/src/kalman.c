#include "lanes.h"

#include <math.h>
#include <string.h>

#define OUTGROWN ((ts_real)0.01) /* of the prior's: what P has of it when the motion has become larger */
#define STEADY ((ts_real)0.4) /* of the normalised innovation counts where the error has long been small */
#define UNLIKELY 3 /* times the expected first weight: stroke or voltage limits are not those of the actuator */
#define STEEPEST 5 /* times it, at most, that count */
#define USUAL 3 /* mean square of the normalised innovation: a larger one is usual, but no sudden change */
#define SOON 8 /* refractory times after a change: what seems to be another one until then, */
#define RAISED 2 /* with so many times its mean square, is what the law has made of it */

enum { OF_PLAYS = 3, ALONE = 4 }; /* of `part`: what it says of the plays; a weight that stands by itself when P is made */
enum { ROWS = TS_LANES / 2 }; /* of one width, of which a loop over the rows of P takes so many at a time */

/* P is symmetric, and a triangle of it is stored: row i to the end of the block of eight that holds the diagonal, so that
 * rows are whole vectors, and the blocks on the diagonal are whole matrices. */

/* P -= root root', block by block of its columns. */
static void reduce(ts_real *P, const ts_real *root, int m)
{
    for (int j = 0; j < m; j += TS_LANES) {
        lanes columns = load(root + j);
        ts_real *row = P + TS_ROW(j) + j;
        for (int i = j; i < m; row += width(i), i++) store(row, minus(load(row), root[i], columns));
    }
}

/* The same, then P += share (P0 - P): in each row what is 0 in P0, the whole blocks behind it, and the block on the diagonal with
 * its other half. */
static void reduce_and_return(ts_real *P, const ts_real *root, ts_prior P0, ts_real share, int m)
{
    const ts_real *entry = P0.entries;
    for (int i = 0; i < m; P += width(i), i++) {
        int j = 0, from = P0.from ? P0.from[i] : 0, diagonal = width(i) - TS_LANES;
        ts_real own = root[i];
        for (; j < from; j += TS_LANES) {
            lanes x = minus(load(P + j), own, load(root + j));
            store(P + j, minus(x, share, x));
        }
        for (; j < diagonal; j += TS_LANES, entry += TS_LANES) {
            lanes x = minus(load(P + j), own, load(root + j));
            store(P + j, plus(x, share, difference(load(entry), x)));
        }
        ts_real *other = P - (i - j) * width(i) + i;
        for (; j <= i; j++, other += width(i)) {
            ts_real x = P[j] - own * root[j];
            *other = P[j] = x + share * (*entry++ - x);
        }
    }
}

static const ts_real nothing[TS_PADDED(TS_MAX_LEARNED)] = {0};

/* P = P0 + d d'. */
static void fill(ts_real *P, ts_prior P0, const ts_real *d, int m)
{
    const ts_real *entry = P0.entries;
    for (int i = 0; i < m; P += width(i), i++) {
        int j = 0, from = P0.from ? P0.from[i] : 0, diagonal = width(i) - TS_LANES;
        ts_real own = d[i];
        for (; j < from; j += TS_LANES) store(P + j, plus(zero(), own, load(d + j)));
        for (; j < diagonal; j += TS_LANES, entry += TS_LANES) store(P + j, plus(load(entry), own, load(d + j)));
        store(P + diagonal, zero()); /* behind the last column, too */
        ts_real *other = P - (i - j) * width(i) + i;
        for (; j <= i; j++, other += width(i)) *other = P[j] = *entry++ + own * d[j];
    }
}

static void restart(ts_real *P, ts_prior P0, int m)
{
    fill(P, P0, nothing, m);
}

void ts_kalman_init(ts_kalman *k, ts_prior P0, ts_real sigma, int m)
{
    memset(k, 0, sizeof *k);
    restart(k->P, P0, m);
    k->sigma = sigma;
    k->since_change = INT32_MAX;
}

/* Row and column i of P are 0 but for the diagonal. */
static void separate(ts_real *P, int i, ts_real variance, int m)
{
    int block = i - i % TS_LANES;
    ts_real *own = P + TS_ROW(i), *entry = P + TS_ROW(block) + i;
    for (int j = 0; j <= block; j += TS_LANES) store(own + j, zero());
    for (int j = block; j < m; entry += width(j), j++) *entry = 0;
    own[i] = variance;
}

void ts_kalman_separate(ts_kalman *k, int i, ts_real variance, int m)
{
    k->pending = k->changed = false;
    if (k->renews) {
        k->part[i] |= ALONE;
        k->P[TS_ROW(i) + i] = variance;
    } else separate(k->P, i, variance, m);
}

/* What was pending is of no use, for P is another one. */
static void begin_anew(ts_kalman *k, int m)
{
    for (int i = 0; k->renews && i < m; i++) k->part[i] &= OF_PLAYS;
    k->renews = k->started = k->pending = k->changed = false;
    k->change = 0;
    k->variance = 0;
}

void ts_kalman_reset_covariance(ts_kalman *k, ts_prior P0, int m)
{
    begin_anew(k, m);
    restart(k->P, P0, m);
}

void ts_kalman_wait(ts_kalman *k, int ticks)
{
    k->since_change = -ticks;
    k->change = k->at_change = 0;
}

void ts_kalman_renew(ts_kalman *k, const ts_real *d, int ticks, int m)
{
    begin_anew(k, m);
    memcpy(k->Pu, d, sizeof(ts_real) * (size_t)TS_PADDED(m));
    k->renews = true;
    ts_kalman_wait(k, ticks);
}

void ts_kalman_complete(ts_kalman *k, ts_prior P0, int m)
{
    if (!k->renews) return;
    ts_real variance[TS_MAX_LEARNED];
    for (int i = 0; i < m; i++) variance[i] = k->P[TS_ROW(i) + i];
    fill(k->P, P0, k->Pu, m);
    for (int i = 0; i < m; i++) {
        if (k->part[i] >= ALONE) separate(k->P, i, variance[i], m);
        k->part[i] &= OF_PLAYS;
    }
    k->renews = false;
}

void ts_kalman_start_filters(ts_kalman *k, int m)
{
    if (k->started) return;
    memset(k->u1, 0, sizeof(ts_real) * (size_t)m);
    memset(k->u, 0, sizeof(ts_real) * (size_t)m);
    k->y1 = k->y = 0;
    k->started = true;
}

/* P u: each block of eight columns from its diagonal down, for which P is stored as it is, in order of the rows; then the part before
 * the diagonal blocks, row by row. */
static void times(const ts_real *P, const ts_real *u, ts_real *Pu, int m)
{
    for (int j = 0; j < m; j += TS_LANES) {
        lanes sum = zero();
        const ts_real *row = P + TS_ROW(j) + j;
        int i = j;
        for (; i + ROWS <= m; i += ROWS) {
            int next = width(i);
            TS_UNROLLED
            for (int r = 0; r < ROWS; row += next, r++) sum = plus(sum, u[i + r], load(row));
        }
        for (; i < m; row += width(i), i++) sum = plus(sum, u[i], load(row));
        store(Pu + j, sum);
    }
    P += TS_ROW(TS_LANES);
    for (int i = TS_LANES; i < m; P += 2 * width(i), i += 2) { /* two rows at a time, for which u is read once */
        const ts_real *next = i + 1 < m ? P + width(i) : P;
        lanes x = load(u), first = product(load(P), x), second = product(load(next), x);
        for (int j = TS_LANES; j < width(i) - TS_LANES; j += TS_LANES) {
            x = load(u + j);
            first = plus_product(first, load(P + j), x);
            second = plus_product(second, load(next + j), x);
        }
        Pu[i] += total(first);
        if (i + 1 < m) Pu[i + 1] += total(second);
    }
}

/* The same two poles for the regressor and the measurement: their linear relation stays, the fast dynamics of the
 * stage, which are not in the model, are removed. */
static void pass_filter(ts_kalman *k, ts_real pole, const ts_real *u, ts_real y, int m)
{
    if (!k->started) {
        memcpy(k->u1, u, sizeof(ts_real) * (size_t)m);
        memcpy(k->u, u, sizeof(ts_real) * (size_t)m);
        k->y1 = k->y = y;
        k->started = true;
    }
    for (int i = 0; i < m; i += TS_LANES) {
        lanes once = load(k->u1 + i), twice = load(k->u + i);
        once = plus(once, pole, difference(load(u + i), once));
        twice = plus(twice, pole, difference(once, twice));
        store(k->u1 + i, once);
        store(k->u + i, twice);
    }
    k->y1 += pole * (y - k->y1);
    k->y += pole * (k->y1 - k->y);
}

/* Over the ticks of half a half-wave, times four because it is not white. */
ts_real ts_kalman_noise_of_sine(const ts_kalman *k, ts_real amplitude, ts_real frequency)
{
    ts_real w = 2 * TS_PI * frequency * (1 - k->filter) / k->filter, left = amplitude / (1 + w * w);
    return left * left / (2 * frequency);
}

/* Noise from the second difference of the innovation, d = e(k) - 2 e(k-1) + e(k-2), whose variance is 6 sigma^2 and
 * whose mean magnitude is 1.9544 sigma: slowly and robustly (sigma), and quickly, so that ringing counts (ringing). */
static void follow_noise(ts_kalman *k, const ts_kalman_settings *s, ts_real innovation, bool measured)
{
    ts_real d = innovation - 2 * k->innovation1 + k->innovation2;
    k->innovation2 = k->innovation1;
    k->innovation1 = innovation;
    if (!measured) return;
    if (d < 0) d = -d;
    if (d > TS_LARGEST) d = TS_LARGEST;
    k->ringing += s->ringing_rate * (d * d / 6 - k->ringing);
    /* Clipped at four standard deviations; the model error keeps sigma above 0 at rest. */
    ts_real most = (ts_real)7.84 * (k->sigma > s->model_error ? k->sigma : s->model_error);
    if (d > most) d = most;
    k->sigma += s->noise_rate * (d / (ts_real)1.9544 - k->sigma);
}

/* After a change the weights of the plays may be off together: all by change_gain, all but the first by
 * change_hysteresis of their size. */
static void admit_change(ts_kalman *k, const ts_kalman_settings *s, const ts_real *w, int m)
{
    ts_real gain2 = s->change_gain * s->change_gain, hysteresis2 = s->change_hysteresis * s->change_hysteresis;
    ts_real of_plays[TS_PADDED(TS_MAX_LEARNED)], share[TS_PADDED(TS_MAX_LEARNED)]; /* the latter where the row is of another play */
    for (int i = 0; i < TS_PADDED(m); i++) {
        int part = i < m ? k->part[i] : 0;
        of_plays[i] = part > 0 ? w[i] : 0;
        share[i] = part == 2 ? gain2 + hysteresis2 : gain2;
    }
    for (int j = 0; j < m; j += TS_LANES) {
        lanes columns = load(of_plays + j), of_hysteresis = load(share + j);
        ts_real *row = k->P + TS_ROW(j) + j;
        for (int i = j; i < m; row += width(i), i++) {
            if (k->part[i] == 1) store(row, plus(load(row), gain2, scaled(of_plays[i], columns)));
            if (k->part[i] == 2) store(row, plus_product(load(row), of_hysteresis, scaled(of_plays[i], columns)));
        }
    }
}

/* By how much faster P returns to the prior where the actuator is far steeper than that says: deviations are relative to the
 * weights, variances to their square. The first weight is the slope at a turn. */
static ts_real haste(ts_real slope, ts_real expected)
{
    if (!(expected > 0) || !(slope > UNLIKELY * expected)) return 1;
    ts_real steeper = slope / expected;
    if (steeper > STEEPEST) steeper = STEEPEST;
    return steeper * steeper;
}

/* Second tick of an update: P -= P u u'P / variance, its return to the prior, and more of it after a change. */
static void follow_covariance(ts_kalman *k, const ts_kalman_settings *s, const ts_real *w0, ts_prior P0, const ts_real *w, int m)
{
    ts_real root[TS_PADDED(TS_MAX_LEARNED)], scale = 1 / root_of(k->variance), back = 0;
    lanes taken = zero();
    for (int i = 0; i < m; i += TS_LANES) {
        lanes part = scaled(scale, load(k->Pu + i));
        store(root + i, part);
        taken = plus_product(taken, part, part);
    }
    if (!(total(taken) <= TS_LARGEST * TS_LARGEST)) { /* P is no longer definite */
        restart(k->P, P0, m);
        memset(root, 0, sizeof root);
    }
    if (k->since_return >= TS_RETURN_EVERY) {
        k->since_return = 0;
        back = s->prior_return;
    }
    if (k->changed) back += s->change_share;
    if (k->outgrown) back += OUTGROWN;
    if (back > 0 && k->calm) back *= haste(w[0], w0[0]);
    if (back > 0) reduce_and_return(k->P, root, P0, back < 1 ? back : 1, m);
    else reduce(k->P, root, m);
    if (k->changed) admit_change(k, s, w, m);
    k->pending = k->changed = k->outgrown = false;
}

static inline ts_real plus_all(ts_real sum, const ts_real *a, int n)
{
    TS_UNROLLED
    for (int i = 0; i < n; i++) sum += a[i];
    return sum;
}

/* sum = before + columns of P, `count` of them from `from` on, within one block of eight, in their order. */
static inline void add_columns(const ts_real *P, const ts_real *before, ts_real *sum, int from, int count, int m)
{
    int block = from - from % TS_LANES;
    for (int j = 0; j <= block; j += TS_LANES) { /* P is symmetric: for these rows the columns are stored as rows */
        lanes x = load(before + j);
        const ts_real *row = P + TS_ROW(from) + j;
        TS_UNROLLED
        for (int i = 0; i < count; row += width(block), i++) x = plus(x, 1, load(row));
        store(sum + j, x);
    }
    int j = block + TS_LANES;
    const ts_real *row = P + TS_ROW(j) + from;
    for (; j + ROWS <= m; j += ROWS) {
        int next = width(j);
        TS_UNROLLED
        for (int r = 0; r < ROWS; row += next, r++) sum[j + r] = plus_all(before[j + r], row, count);
    }
    for (; j < m; row += width(j), j++) sum[j] = plus_all(before[j], row, count);
    for (; j % TS_LANES > 0; j++) sum[j] = 0;
}

/* The sum of the first `columns`. */
static const ts_real *add_up_to(const ts_kalman *k, ts_column_sums *s, int columns, int m)
{
    if (s->columns > columns) s->columns = columns - columns % TS_LANES;
    while (s->columns < columns) {
        int from = s->columns, block = from / TS_LANES, begun = from % TS_LANES, count = TS_LANES - begun;
        ts_real *sum = s->to_end_of[block];
        const ts_real *before = begun ? sum : block ? s->to_end_of[block - 1] : nothing;
        if (count > columns - from) count = columns - from;
        if (count == TS_LANES) add_columns(k->P, before, sum, from, TS_LANES, m); /* a loop of known length is faster */
        else add_columns(k->P, before, sum, from, count, m);
        s->columns += count;
    }
    return s->to_end_of[(columns - 1) / TS_LANES];
}

/* How many of the first `columns` weights are of no play. */
static int rates_up_to(const ts_kalman *k, ts_column_sums *s, int columns)
{
    int rates = s->rates;
    for (int i = s->looked; i < columns; i++)
        if (k->part[i] == 0) s->rate[rates++] = i;
    s->rates = rates;
    if (s->looked < columns) s->looked = columns;
    while (rates > 0 && s->rate[rates - 1] >= columns) rates--;
    return rates;
}

/* Eight rows of a column of P, from row `begin` on; 0 behind the last one. */
static inline lanes part_of_column(const ts_real *P, int column, int begin, int m)
{
    if (begin <= column) return load(P + TS_ROW(column) + begin); /* P is symmetric: stored as a row */
    const ts_real *entry = P + TS_ROW(begin) + column;
    int next = width(begin);
    ts_real x[TS_LANES];
    if (m - begin < TS_LANES) {
        store(x, zero());
        for (int i = 0; i < m - begin; entry += next, i++) x[i] = *entry;
        return load(x);
    }
    TS_UNROLLED
    for (int i = 0; i < TS_LANES; entry += next, i++) x[i] = *entry;
    return load(x);
}

/* The sum of the first `rates` of those of no play, from the one of the last call on where it has no more. */
static const ts_real *add_rates(const ts_kalman *k, ts_column_sums *s, int rates, int m)
{
    int summed = s->summed <= rates ? s->summed : 0;
    if (rates == 0) return nothing;
    for (int j = 0; j < m; j += TS_LANES) {
        lanes x = load(summed > 0 ? s->of_rates + j : nothing);
        for (int i = summed; i < rates; i++) x = plus(x, 1, part_of_column(k->P, s->rate[i], j, m));
        store(s->of_rates + j, x);
    }
    s->summed = rates;
    return s->of_rates;
}

void ts_kalman_project(const ts_kalman *k, ts_real *w, ts_column_sums *sums, int columns, ts_real rate, ts_real missing, int m)
{
    if (sums->columns == 0) sums->rates = sums->looked = sums->summed = 0;
    int rates = rates_up_to(k, sums, columns);
    const ts_real *of_all = add_up_to(k, sums, columns, m), *of_rates = add_rates(k, sums, rates, m);
    ts_real Pg[TS_PADDED(TS_MAX_LEARNED)], g_Pall = 0, g_Prates = 0;
    int block = 0;
    do { /* m is 1 at least */
        store(Pg + block, plus(load(of_all + block), rate - 1, load(of_rates + block)));
        block += TS_LANES;
    } while (block < m);
    TS_UNROLLED
    for (int i = 0; i < columns; i++) g_Pall += Pg[i];
    for (int i = 0; i < rates; i++) g_Prates += Pg[sums->rate[i]];
    ts_real g_Pg = g_Pall + (rate - 1) * g_Prates, step = missing / g_Pg;
    if (!(g_Pg > 0) || !isfinite(g_Pg) || !isfinite(step)) return;
    move_weights(w, step, Pg, m);
}

/* Whether the actuator has changed, by the normalised innovation, squared, and the innovation, um: no longer where the law takes
 * for one what it has made of the last one. */
static void detect_change(ts_kalman *k, const ts_kalman_settings *s, ts_real nu2, ts_real e)
{
    ts_real size = e * e, most = TS_LARGEST * TS_LARGEST;
    k->power += s->change_rate * ((size < most ? size : most) - k->power);
    k->change += s->change_rate * (nu2 - k->change);
    bool found = k->change > s->change_threshold && k->since_change >= s->refractory;
    bool own = k->small && k->at_change > 0 && k->since_change / SOON < s->refractory && k->power > RAISED * k->at_change;
    if (found) {
        k->change = 0;
        k->since_change = 0;
    }
    k->changed = found && !own;
    if (k->changed) k->at_change = k->power;
}

/* First tick of an update: the weights, and their return to the prior. False where P is no longer definite, which then
 * starts anew, and where the divisor is 0: no motion, no noise, no error of the model. */
static bool update(ts_kalman *k, const ts_kalman_settings *s, const ts_real *w0, ts_prior P0, ts_real *w, int m)
{
    times(k->P, k->u, k->Pu, m);
    ts_real explained = dot(k->u, k->Pu, TS_PADDED(m)), e = k->y - dot(k->u, w, TS_PADDED(m));
    if (!(explained >= 0) || !isfinite(explained * e)) {
        restart(k->P, P0, m);
        return false;
    }
    ts_real floor = s->model_error * s->model_error + k->disturbance + k->load + k->caution, quiet = k->sigma * k->sigma;
    ts_real noise = k->ringing / 2 > quiet ? k->ringing / 2 : quiet;
    ts_real expected = explained + (quiet + floor) / 2; /* every second tick is used: each stands for two */
    if (!(expected > 0)) return false;
    ts_real variance = explained + (noise + floor) / 2, gain = e / variance;
    if (!isfinite(variance) || !isfinite(gain)) return false;
    k->variance = variance;
    move_weights(w, gain, k->Pu, m);
    k->since_return += 2;
    if (k->since_return >= TS_RETURN_EVERY)
        for (int i = 0; i < m; i++) w[i] += s->prior_return * (w0[i] - w[i]);

    ts_real nu2 = e * e / expected, whole = nu2 < 100 ? nu2 : 100;
    if (k->steady) nu2 *= STEADY;
    if (!(nu2 < 100)) nu2 = 100;
    if (s->usual_rate > 0 && k->relates) {
        ts_real rate = (ts_real)k->relates * s->usual_rate;
        k->usual += (rate < 1 ? rate : 1) * (whole - k->usual);
        if (k->usual > USUAL) nu2 *= USUAL / k->usual;
    }
    detect_change(k, s, nu2, e);
    k->pending = true;
    return true;
}

bool ts_kalman_is_spike(ts_kalman *k, const ts_kalman_settings *s, ts_real innovation, ts_real noisy, bool smooth)
{
    if (!(k->variance > 0)) return false; /* before the first update the model may be far off */
    ts_real most = s->outlier * s->outlier, noise = k->sigma * k->sigma, d = noisy - 2 * k->innovation1 + k->innovation2;
    bool sudden = !smooth || d * d > most * (noise + k->ringing);
    bool beyond = innovation * innovation > most * (k->variance + noise) && sudden, spike = beyond && k->spikes < s->outliers;
    k->spikes = beyond ? k->spikes + spike : 0;
    return spike;
}

bool ts_kalman_tick(ts_kalman *k, const ts_kalman_settings *s, const ts_real *w0, ts_prior P0, ts_real *w,
                    const ts_real *u, ts_real y, ts_real innovation, bool measured, bool learn, int m)
{
    ts_kalman_complete(k, P0, m);
    if (learn) {
        follow_noise(k, s, innovation, measured);
        pass_filter(k, k->filter, u, y, m);
    } else k->started = false; /* a tick that is not used must not stay in the filters either */
    if (k->since_change < INT32_MAX) k->since_change++;
    if (k->pending) {
        follow_covariance(k, s, w0, P0, w, m);
        return false;
    }
    return measured && learn && k->since_change >= 0 && update(k, s, w0, P0, w, m);
}
