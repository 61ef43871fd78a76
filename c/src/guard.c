#include "lanes.h"

#include <limits.h>
#include <math.h>

#define SHARE ((ts_real)0.02)   /* of the motion's range: a smaller error is no failure, */
#define WORSE 4                 /* nor one below so many times the best, */
#define NOISES 6                /* nor one of so many standard deviations of a measurement */
#define FALLS ((ts_real)0.7)    /* of the window before: an error that falls so fast is being learned */
#define BAD 3                   /* windows in a row that are a failure, */
#define BEYOND_ALL 2            /* and where the error is larger than the motion: without a controller it were less */
#define BETTER ((ts_real)0.7)   /* of the error that failed: what was restored is better */
#define FIRST_WAIT 4            /* windows of the first hold, */
#define LONGEST_WAIT 256        /* and of the longest */
#define SETTLES 12              /* windows in which the stage may calm down */
#define RISE ((ts_real)1.02)    /* of the best, per window */
#define FORGIVEN 8              /* times `wait` good windows until the next hold is shorter again */

/* Standard deviation of the error in the window that ends, um. */
static ts_real deviation(const ts_guard *g)
{
    ts_real n = (ts_real)g->counted, mean = g->sum / n, variance = g->square / n - mean * mean;
    return variance > 0 ? (ts_real)sqrt(variance) : 0;
}

static void begin_window(ts_guard *g)
{
    g->sum = g->square = 0;
    g->ticks = g->counted = 0;
}

static void follow(ts_guard *g, const ts_guard_settings *s, ts_real error, ts_real z_d, bool counts)
{
    if (!g->started) {
        g->started = true;
        g->low = g->high = z_d;
        g->wait = FIRST_WAIT;
    }
    g->low += s->range_rate * (z_d - g->low);
    g->high += s->range_rate * (z_d - g->high);
    if (z_d < g->low) g->low = z_d;
    if (z_d > g->high) g->high = z_d;
    g->ticks++;
    if (!counts) return;
    if (g->counted == 0) g->first = error;
    ts_real e = error - g->first;
    g->sum += e;
    g->square += e * e;
    g->counted++;
}

/* The held weights: whether they are better is known when the error no longer falls. */
static ts_guard_action judge_held(ts_guard *g, ts_real error)
{
    bool falls = error < (ts_real)0.9 * g->error && g->held < SETTLES + g->wait, better = error < BETTER * g->failed;
    g->error = error;
    g->held++;
    if (g->held <= (better ? g->wait : FIRST_WAIT) || falls) return TS_GUARD_NOTHING;
    if (!better && g->kept && !g->at_start) {
        g->at_start = true;
        g->held = 1;
        return TS_GUARD_FIRST;
    }
    g->held = g->bad = g->good = 0;
    g->pause = better ? 1 : g->wait;
    g->wait = g->wait < LONGEST_WAIT ? 2 * g->wait : LONGEST_WAIT;
    if (g->at_start) g->kept = false;
    g->at_start = false;
    return better ? TS_GUARD_ADOPT : TS_GUARD_RETURN;
}

/* The weights that learn. */
static ts_guard_action judge_learned(ts_guard *g, const ts_guard_settings *s, ts_real error, ts_real noise)
{
    ts_real range = g->high - g->low, least = SHARE * range, limit = WORSE * g->best * range;
    if (least < s->floor) least = s->floor;
    if (least < NOISES * noise) least = NOISES * noise;
    bool large = error > least && error > limit, falls = error < FALLS * g->error;
    int most = error > range && error > 10 * s->floor ? BEYOND_ALL : BAD;
    g->error = error;
    g->bad = !large || falls || g->pause > 0 ? 0 : g->bad + 1;
    if (g->pause > 0) g->pause--;
    if (g->bad >= most) {
        g->failed = error;
        g->held = 1;
        return TS_GUARD_RESTORE;
    }
    g->good = error > least ? 0 : g->good + 1;
    if (g->good > FORGIVEN * g->wait && g->wait > FIRST_WAIT) {
        g->wait /= 2;
        g->good = 0;
    }
    g->best *= RISE;
    if (!(range > 10 * s->floor) || error > least) return TS_GUARD_NOTHING;
    if (g->kept && error > g->best * range) return TS_GUARD_NOTHING;
    g->best = error / range;
    g->kept = true;
    return TS_GUARD_KEEP;
}

ts_guard_action ts_guard_tick(ts_guard *g, const ts_guard_settings *s, ts_real error, ts_real z_d, bool counts, ts_real noise)
{
    follow(g, s, error, z_d, counts);
    if (g->ticks < s->window) return TS_GUARD_NOTHING;
    bool enough = 4 * g->counted >= s->window;
    ts_real e = enough ? deviation(g) : 0;
    begin_window(g);
    if (!enough) return TS_GUARD_NOTHING;
    return g->held > 0 ? judge_held(g, e) : judge_learned(g, s, e, noise);
}
