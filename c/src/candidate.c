/* A stage that is shown, before it is put into the model. */
#include "controller.h"

#include <string.h>

#define TOO_MUCH ((ts_real)4) /* times the rms of what the law misses: a stage that misses more is not that of the measurements */
#define FEWEST 20          /* ticks that show it */

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
    ts_real missed = z - made - t->direct * strain;
    t->made[1] = t->made[0];
    t->made[0] = made;
    t->ticks += 1;
    add_moments(t->missed, missed);
    add_moments(t->speed, zdot_d);
    add_moments(t->own, own);
    t->product += missed * zdot_d;
}

/* One tick of a law without a stage in its model, with what it has learned: the strain is that of all terms but lag and inertia, which
 * the stage has. */
void ts_candidate_tick(ts_controller *c, ts_real z, ts_real zdot_d)
{
    ts_candidate *t = &c->candidate;
    const int *n = c->settings->terms;
    int lag = c->of_plays + n[TS_CREEP], inertia = lag + n[TS_LAG];
    ts_real expected = model(c, c->u), strain = expected;
    if (n[TS_LAG] > 0) strain -= c->w[lag] * c->u[lag];
    if (n[TS_INERTIA] > 0) strain -= c->w[inertia] * c->u[inertia];
    if (c->resonance.ticks == 0 || !(t->frequency > 0)) begin_candidate(c, strain);
    if (t->frequency > 0) count_candidate(t, z, zdot_d, strain, z - expected);
    t->strain = strain;
}

/* Mean square about the mean, of these sums. */
static ts_real spread_of(const ts_real *sum, ts_real ticks)
{
    ts_real mean = sum[0] / ticks;
    return sum[1] / ticks - mean * mean;
}

/* A window of the estimate has ended: what the stage misses beside an offset and a lag. */
void ts_candidate_end(ts_controller *c)
{
    ts_candidate *t = &c->candidate;
    ts_real tried = t->frequency, n = t->ticks;
    t->worse = t->frequency = 0;
    if (!(tried > 0 && n > FEWEST)) return;
    ts_real missed = spread_of(t->missed, n), speed = spread_of(t->speed, n), both = t->product / n - t->missed[0] / n * (t->speed[0] / n);
    if (speed > 0) missed -= both * both / speed;
    if (missed > TOO_MUCH * TOO_MUCH * spread_of(t->own, n)) t->worse = tried;
}
