#include "lanes.h"

#include <limits.h>
#include <math.h>

#define SHARE ((ts_real)0.02)   /* of the motion's range: a smaller error is no failure, */
#define WORSE 4                 /* nor one below so many times the best, */
#define NOISES 6                /* nor one of so many standard deviations of a measurement */
#define FALLS ((ts_real)0.7)    /* of the window before: an error that falls so fast is being learned */
#define BAD 3                   /* windows in a row that are a failure, */
#define BAD_AT_FIRST 5          /* while nothing is learned yet, */
#define LARGER 2                /* or of a motion that was so many times as small, */
#define BEYOND_ALL 2            /* and where it is larger than half of the motion */
#define PROMISES ((ts_real)0.5) /* of the error that fails: weights that miss less than it are worth a trial */
#define HARMS ((ts_real)0.1)    /* of the motion's range: a larger error of a stage that has entered the model is a failure at once, */
#define MADE_WORSE 3            /* above so many times what it was without it */
#define BETTER ((ts_real)0.7)   /* of the error that failed: what was restored is better */
#define HOPELESS 2              /* times the error that failed: what was restored is worse, */
#define TRANSIENT 2             /* after so many windows */
#define SETTLES 12              /* windows in which the stage may calm down */
#define LEAST_RANGE 10          /* of the floor: a smaller motion is rest */
#define WIDENS ((ts_real)1.5)   /* times the range of the window before: a motion that grows, in which no weights are good yet */
#define RISE ((ts_real)1.02)    /* of the best, per window */
#define CENTRING ((ts_real)0.5) /* of the mean error, in a window */
#define LEAST_BURST 20          /* of the floor: a smaller error is no burst */
#define GROWS ((ts_real)1.5)    /* times the half-wave before: a half-wave that grows */
#define DECAYS ((ts_real)0.95)  /* in a window: what counts as ringing of a stage that was found */
#define LONG 10                 /* windows with a small error after which others are kept where the model was lost, */
#define LONG_AT_REST 100        /* and where the range of the motion is less than half of what it was */
#define MOVES ((ts_real)0.1)    /* of the motion's range: less of it, up and down, shows nothing, */
#define MOST_BLOCKS 1000        /* in which the motion may come so far */
#define MISSED ((ts_real)0.01)  /* of the motion since then: what kept weights may miss, */
#define OF_NOISE 2              /* with so many standard deviations of a measurement, */
#define MOVED_BY ((ts_real)0.05) /* and of the range: by how much they may be off as a whole */
#define FORGIVEN 8              /* times `wait` good windows until the next hold is shorter again */

static void count(ts_spread *s, ts_real x)
{
    if (s->counted == 0) {
        s->first = x;
        s->sum = s->square = 0;
    }
    ts_real e = x - s->first;
    s->sum += e;
    s->square += e * e;
    s->counted++;
}

static ts_real mean_of(const ts_spread *s)
{
    return s->first + s->sum / (ts_real)s->counted;
}

/* Rounding may make it less than 0. */
static ts_real variance_of(const ts_spread *s)
{
    ts_real n = (ts_real)s->counted, mean = s->sum / n;
    return s->square / n - mean * mean;
}

static ts_real deviation_of(const ts_spread *s)
{
    ts_real variance = variance_of(s);
    return variance > 0 ? root_of(variance) : 0;
}

static void begin_window(ts_guard *g)
{
    g->ticks = g->errors.counted = g->missed.counted = 0;
}

void ts_guard_compare(ts_guard *g, ts_real missed)
{
    count(&g->missed, missed);
}

/* How many half-waves of the error in a row have each grown beyond the one before. */
static void follow_swings(ts_guard *g, const ts_guard_settings *s, ts_real error)
{
    ts_real size = size_of(g->swing);
    if ((error < 0 && g->swing > 0) || (error > 0 && g->swing < 0)) {
        bool grows = size > s->floor && size > GROWS * g->swung;
        g->swings = !grows ? 0 : g->swings < TS_SWINGS ? g->swings + 1 : TS_SWINGS;
        g->swung = size;
        g->swing = error;
    } else if (size_of(error) > size) {
        g->swing = error;
    }
}

static void follow(ts_guard *g, const ts_guard_settings *s, ts_real error, ts_real z_d, bool counts)
{
    if (!g->started) {
        g->started = true;
        g->start = error;
        g->low = g->high = z_d;
    }
    g->low += s->range_rate * (z_d - g->low);
    g->high += s->range_rate * (z_d - g->high);
    if (z_d < g->low) g->low = z_d;
    if (z_d > g->high) g->high = z_d;
    g->ticks++;
    if (!counts) return;
    if (s->burst > 0) follow_swings(g, s, error);
    count(&g->errors, error);
}

/* The held weights: whether they are better is known when the error no longer falls. */
static ts_guard_action judge_held(ts_guard *g, ts_real error)
{
    bool falls = error < (ts_real)0.9 * g->error && g->held < SETTLES + g->wait, better = error < BETTER * g->failed;
    g->error = error;
    g->held++;
    bool hopeless = g->held > TRANSIENT && error > HOPELESS * g->failed;
    if (!hopeless && (g->held <= (better ? g->wait : TS_FIRST_WAIT) || falls)) return TS_GUARD_NOTHING;
    g->drift = 0;
    if (!hopeless && !better && g->kept && !g->at_start) {
        g->at_start = true;
        g->held = 1;
        return TS_GUARD_FIRST;
    }
    g->held = g->bad = g->good = 0;
    g->entered = 0;
    g->pause = better ? 1 : g->wait;
    g->wait = g->wait < TS_LONGEST_WAIT ? 2 * g->wait : TS_LONGEST_WAIT;
    if (g->at_start && !hopeless) {
        g->kept = false;
        g->best = 0;
    }
    g->at_start = false;
    return better ? TS_GUARD_ADOPT : TS_GUARD_RETURN;
}

bool ts_guard_promises(const ts_guard *g, ts_real error)
{
    return g->promised < PROMISES * error;
}

/* The weights that learn; `whole`: the error with its mean. */
static ts_guard_action judge_learned(ts_guard *g, const ts_guard_settings *s, ts_real error, ts_real whole, ts_real least)
{
    ts_real range = ts_guard_range(g, s);
    bool large = error > least && error > WORSE * g->best && error * range > g->ringing;
    bool falls = error < FALLS * g->error;
    bool proven = g->kept && range < LARGER * g->span;
    int most = 2 * error > 1 ? BEYOND_ALL : proven ? BAD : BAD_AT_FIRST;
    g->error = error;
    g->ringing *= DECAYS;
    g->small = whole > least ? 0 : g->small < LONG_AT_REST ? g->small + 1 : g->small;
    g->lost = g->lost || (s->recall > 0 && g->kept && g->settled && large);
    bool harmed = g->pause > 0 && g->entered > 0 && error > HARMS && error > MADE_WORSE * g->entered;
    bool excused = !large || (g->pause > 0 && !harmed && 2 * error <= 1);
    g->bad = excused ? 0 : g->bad + (!falls && g->bad < most);
    if (g->pause > 0) g->pause--;
    if (g->bad >= most && !falls && (harmed || 2 * error > 1 || ts_guard_promises(g, error))) {
        g->failed = error;
        g->held = 1;
        g->drift = 0;
        g->small = 0;
        return TS_GUARD_RESTORE;
    }
    g->good = error > least ? 0 : g->good < FORGIVEN * TS_LONGEST_WAIT ? g->good + 1 : g->good;
    if (g->good >= FORGIVEN * g->wait && g->wait > TS_FIRST_WAIT) {
        g->wait /= 2;
        g->good = 0;
    }
    g->best *= RISE;
    bool moves = g->high - g->low > LEAST_RANGE * s->floor;
    if (!g->kept && !g->lost) {
        bool grows = range > WIDENS * g->span;
        g->span = range;
        g->grown = moves && !grows;
        if (grows) return TS_GUARD_NOTHING;
    }
    if (!moves || error > least || (g->kept && error > g->best)) return TS_GUARD_NOTHING;
    if (g->lost && g->small < (2 * range > g->span ? LONG : LONG_AT_REST)) return TS_GUARD_NOTHING;
    g->best = error;
    g->span = range;
    g->kept = true;
    g->lost = false;
    g->settled = g->small >= TS_SETTLED;
    return TS_GUARD_KEEP;
}

void ts_guard_begin(ts_guard *g)
{
    begin_window(g);
    g->entered = g->error;
    g->pause = g->wait;
    g->held = g->bad = g->good = 0;
    g->at_start = false;
}

/* Whether the error swings up beyond the motion so far, before it was small for long; that of a sensor that fails jumps. */
static bool swings_up(const ts_guard *g, const ts_guard_settings *s, ts_real error)
{
    ts_real size = size_of(error);
    if (!g->kept || g->settled || g->held > 0 || g->pause > 0 || g->swings < TS_SWINGS) return false;
    return size > GROWS * g->swung && size > g->high - g->low && size > LEAST_BURST * s->floor;
}

/* Whether an error is far beyond the motion so far, before anything was good. */
static bool bursts(const ts_guard *g, const ts_guard_settings *s, ts_real error, ts_real z_d)
{
    ts_real size = error < 0 ? -error : error, first = g->start < 0 ? -g->start : g->start;
    ts_real motion = g->high - g->low, away = z_d < 0 ? -z_d : z_d;
    if (g->kept || g->held > 0 || !(s->burst > 0)) return false;
    if (motion < away) motion = away; /* a sensor that was not zeroed: the first command goes this far */
    return size > s->burst * motion && size > LEAST_BURST * s->floor && size > 2 * first;
}

ts_real ts_guard_range(const ts_guard *g, const ts_guard_settings *s)
{
    ts_real range = g->high - g->low, least = LEAST_RANGE * s->floor;
    return range > least ? range : least;
}

ts_guard_action ts_guard_tick(ts_guard *g, const ts_guard_settings *s, ts_real error, ts_real z_d, bool counts, ts_real noise)
{
    follow(g, s, error, z_d, counts);
    if (counts && (bursts(g, s, error, z_d) || swings_up(g, s, error))) {
        g->failed = 1;
        g->held = 1;
        g->drift = 0;
        begin_window(g);
        return TS_GUARD_RESTORE;
    }
    if (g->ticks < s->window) return TS_GUARD_NOTHING;
    bool enough = 4 * g->errors.counted >= s->window;
    ts_real range = ts_guard_range(g, s), found = enough ? deviation_of(&g->errors) / range : 0, least = SHARE, mean = 0;
    if (4 * g->missed.counted >= s->window) g->promised = deviation_of(&g->missed) / range;
    else if (g->bad == 0) g->promised = 0;
    if (enough) {
        mean = mean_of(&g->errors);
        g->drift = CENTRING * mean / (ts_real)s->window;
    }
    begin_window(g);
    if (!enough) return TS_GUARD_NOTHING;
    if (least * range < s->floor) least = s->floor / range;
    if (least * range < NOISES * noise) least = NOISES * noise / range;
    mean /= range;
    return g->held > 0 ? judge_held(g, found) : judge_learned(g, s, found, root_of(found * found + mean * mean), least);
}

void ts_guard_recall(ts_guard *g)
{
    ts_guard_begin(g);
    if (!g->kept) g->best = SHARE;
    g->kept = true;
    g->lost = false;
    g->small = 0;
    g->pause = 1;
    g->wait = TS_FIRST_WAIT;
    g->ringing = 0;
}

bool ts_recall_tick(ts_recall *r, const ts_guard_settings *s, ts_real z, ts_real missed, ts_real range, ts_real noise, ts_real *offset)
{
    if (r->missed.counted == 0) {
        r->low = r->high = z;
        r->rose = r->fell = 0;
    }
    count(&r->missed, missed);
    if (z < r->low) r->low = z;
    if (z > r->high) r->high = z;
    if (z - r->low > r->rose) r->rose = z - r->low;
    if (r->high - z > r->fell) r->fell = r->high - z;
    if (r->missed.counted % s->recall != 0) return false;
    ts_real most = MISSED * (r->high - r->low) + OF_NOISE * noise, least = MOVES * range;
    *offset = mean_of(&r->missed);
    bool near = *offset < MOVED_BY * range && *offset > -MOVED_BY * range;
    bool good = near && variance_of(&r->missed) < most * most, enough = r->rose > least && r->fell > least;
    if (!good || enough || r->missed.counted >= MOST_BLOCKS * s->recall) r->missed.counted = 0; /* the comparison begins anew */
    return good && enough;
}
