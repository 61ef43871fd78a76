/* A stage that is shown, before it is put into the model. */
#include "controller.h"

#include <string.h>

#define TOO_MUCH ((ts_real)4) /* times the rms of what the law misses: a stage that misses more is not that of the measurements */
#define FEWEST 20          /* ticks that show it */
#define INDEPENDENT ((ts_real)0.01) /* share of the level's square that the velocity is no part of: with less there is no gain beside it */

#define LARGEST_GAIN ((ts_real)0.5) /* what weights take beside a stage, in size: more is no matter of a stage, */
#define LATEST ((ts_real)5)         /* nor a lag of more radians at the resonance, */
#define SOONEST ((ts_real)0.5)      /* or one that is a lead of so many */

/* The stage that is known now, if any, at rest at this strain, um. */
static void begin_candidate(ts_controller *c, ts_real strain)
{
    ts_candidate *t = &c->candidate;
    ts_real before = t->strain;
    memset(t, 0, sizeof *t);
    t->frequency = c->resonance.known;
    if (!(t->frequency > 0)) return;
    ts_dynamics g;
    ts_make_dynamics(&g, t->frequency, c->settings->oscillation.tick, 1);
    memcpy(t->section, g.section[0], sizeof t->section);
    t->direct = g.direct[0];
    t->strain = before;
    ts_real gain = (t->section[0] + t->section[1]) / (1 + t->section[2] + t->section[3]);
    t->made[0] = gain * strain;
    t->made[1] = gain * before;
}

static void add_moments(ts_real *sum, ts_real x)
{
    sum[0] += x;
    sum[1] += x * x;
}

/* One tick: z, um, would be that of the stage at the strain of the plays alone, um, but for a lag; the law misses `own`, um. */
static void count_candidate(ts_candidate *t, ts_real z, ts_real zdot_d, ts_real strain, ts_real own)
{
    const ts_real *q = t->section;
    ts_real made = q[0] * strain + q[1] * t->strain - q[2] * t->made[0] - q[3] * t->made[1];
    ts_real level = made + t->direct * strain, missed = z - level;
    if (!(t->ticks > 0)) t->first = level;
    level -= t->first;
    t->made[1] = t->made[0];
    t->made[0] = made;
    t->ticks += 1;
    add_moments(t->missed, missed);
    add_moments(t->speed, zdot_d);
    add_moments(t->level, level);
    add_moments(t->own, own);
    t->missed_speed += missed * zdot_d;
    t->missed_level += missed * level;
    t->speed_level += zdot_d * level;
}

/* One tick of a law without a stage in its model, with what it has learned: the strain is that of all terms but the lag, the inertia and the
 * rate weights, which the stage has. */
void ts_candidate_tick(ts_controller *c, ts_real z, ts_real zdot_d)
{
    ts_candidate *t = &c->candidate;
    const ts_settings *s = c->settings;
    const int *n = s->terms;
    int lag = c->of_plays + n[TS_CREEP], inertia = lag + n[TS_LAG];
    ts_real expected = model(c, c->u), strain = expected;
    if (n[TS_LAG] > 0) strain -= c->w[lag] * c->u[lag];
    if (n[TS_INERTIA] > 0) strain -= c->w[inertia] * c->u[inertia];
    for (int i = 0, at = 0; i < s->plays; i++, at++)
        if (s->rate_dependent[i]) {
            at++;
            strain -= c->w[at] * c->u[at];
        }
    if (c->resonance.ticks == 0 || !(t->frequency > 0)) begin_candidate(c, strain);
    if (t->frequency > 0) count_candidate(t, z, zdot_d, strain, z - expected);
    t->strain = strain;
}

/* Mean product of what these are sums of, about their means. */
static ts_real spread_of(ts_real product, const ts_real *a, const ts_real *b, ts_real ticks)
{
    return product / ticks - a[0] / ticks * (b[0] / ticks);
}

/* A window of the estimate has ended: what the stage misses beside an offset, a lag and a gain, by least squares. */
void ts_candidate_end(ts_controller *c)
{
    ts_candidate *t = &c->candidate;
    ts_real tried = t->frequency, n = t->ticks;
    t->worse = t->frequency = t->shown = t->gain = t->lag = t->offset = 0;
    if (!(tried > 0 && n > FEWEST)) return;
    ts_real missed = spread_of(t->missed[1], t->missed, t->missed, n), own = spread_of(t->own[1], t->own, t->own, n);
    ts_real speed = spread_of(t->speed[1], t->speed, t->speed, n), level = spread_of(t->level[1], t->level, t->level, n);
    ts_real by_speed = spread_of(t->missed_speed, t->missed, t->speed, n), by_level = spread_of(t->missed_level, t->missed, t->level, n);
    ts_real both = spread_of(t->speed_level, t->speed, t->level, n), alone = speed * level - both * both;
    ts_real lag = 0, gain = 0, radian = c->settings->oscillation.tick / (2 * TS_PI * tried);
    if (alone > INDEPENDENT * speed * level) {
        lag = (by_speed * level - by_level * both) / alone;
        gain = (by_level * speed - by_speed * both) / alone;
    }
    if (size_of(gain) < LARGEST_GAIN && lag > -LATEST * radian && lag < SOONEST * radian) {
        t->shown = tried;
        t->lag = lag;
        t->gain = gain;
        t->offset = (t->missed[0] - lag * t->speed[0] - gain * t->level[0]) / n - gain * t->first;
        missed -= lag * by_speed + gain * by_level;
    } else if (speed > 0) missed -= by_speed * by_speed / speed;
    if (missed > TOO_MUCH * TOO_MUCH * own) t->worse = tried;
}
