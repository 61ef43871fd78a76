/* A steady tone in the error: a load from outside, and no ringing of the stage. */
#include "lanes.h"

#include <limits.h>

#define BLOCK_PERIODS 4                /* of the centre: a block */
#define LONGEST_BLOCK ((ts_real)1e8)   /* ticks */
#define FEWEST_BLOCKS 9                /* of a window, half a block after each other: fewer show nothing */
#define OFF_MOTION ((ts_real)0.01)     /* the same, of the motion itself, where it is so far from the centre that it shows another frequency: */
#define MOST_TURNS 3                   /* by so many turns in half a block, at most */

static ts_real square_of(const ts_real *a)
{
    return a[0] * a[0] + a[1] * a[1];
}

/* sum += a times b conjugated. */
static void add_product(ts_real *sum, const ts_real *a, const ts_real *b)
{
    sum[0] += a[0] * b[0] + a[1] * b[1];
    sum[1] += a[1] * b[0] - a[0] * b[1];
}

void ts_tone_begin(ts_tone *t, ts_real centre)
{
    memset(t, 0, sizeof *t);
    ts_real half = BLOCK_PERIODS / (2 * centre) + (ts_real)0.5;
    t->block = 2 * (int)(half < 4 ? 4 : half < LONGEST_BLOCK ? half : LONGEST_BLOCK);
    ts_real g = ts_tangent(TS_PI / (ts_real)t->block), all = 1 + g * g;
    t->step[0] = (1 - g * g) / all;
    t->step[1] = 2 * g / all;
    t->turn[0] = 1;
}

static void end_block(ts_tone *t, ts_real *sum)
{
    const ts_real *last = t->before[0], *same = t->before[1];
    if (t->blocks > 0) add_product(t->advance, sum, last);
    if (t->blocks > 1) {
        add_product(t->product, sum, same);
        t->power[0] += square_of(sum);
        t->power[1] += square_of(same);
    }
    memcpy(t->before[1], last, sizeof t->before[1]);
    memcpy(t->before[0], sum, sizeof t->before[0]);
    sum[0] = sum[1] = 0;
    if (t->blocks < INT_MAX) t->blocks++;
}

/* When the desired motion turns upwards, within the tick. */
static void follow_turns(ts_tone *t, ts_real zdot_d)
{
    t->passed++;
    if (t->rate < 0 && !(zdot_d < 0)) {
        t->last = (ts_real)t->passed + zdot_d / (t->rate - zdot_d);
        if (t->turns == 0) t->first = t->last;
        t->turns++;
    }
    t->rate = zdot_d;
}

void ts_tone_tick(ts_tone *t, ts_real error, ts_real zdot_d)
{
    ts_real cosine = t->turn[0], sine = t->turn[1];
    ts_real x = cosine * cosine - sine * sine, y = 2 * cosine * sine; /* twice the angle, */
    ts_real in_phase = (x * x - y * y) * error, behind = -(2 * x * y) * error; /* and four times */
    t->sum[0][0] += (1 - cosine) * in_phase;
    t->sum[0][1] += (1 - cosine) * behind;
    t->sum[1][0] += (1 + cosine) * in_phase;
    t->sum[1][1] += (1 + cosine) * behind;
    t->turn[0] = cosine * t->step[0] - sine * t->step[1];
    t->turn[1] = cosine * t->step[1] + sine * t->step[0];
    follow_turns(t, zdot_d);
    t->ticks++;
    if (2 * t->ticks == t->block) {
        if (t->blocks > 0) end_block(t, t->sum[1]);
        else t->sum[1][0] = t->sum[1][1] = 0; /* the first one had only half of its ticks */
    } else if (t->ticks >= t->block) {
        end_block(t, t->sum[0]);
        t->turn[0] = 1;
        t->turn[1] = 0;
        t->ticks = 0;
    }
}

/* Cycles per tick, of a tone that advances by so much in half a block beside four periods of a block; 0: half a turn, of which the sign
 * is not known. */
static ts_real frequency_of(const ts_tone *t)
{
    ts_real size = root_of(square_of(t->advance)), real = size + t->advance[0];
    if (!(real > 0)) return 0;
    ts_real half_angle = t->advance[1] < 0 ? -ts_arctangent(-t->advance[1] / real) : ts_arctangent(t->advance[1] / real);
    return (BLOCK_PERIODS + 2 * half_angle / TS_PI) / (ts_real)t->block;
}

ts_real ts_tone_of_load(const ts_tone *t, ts_real steady, ts_real orders, ts_real off)
{
    ts_real larger = t->power[t->power[0] > t->power[1] ? 0 : 1];
    if (t->blocks < FEWEST_BLOCKS || !(root_of(square_of(t->product)) > steady * larger)) return 0;
    ts_real frequency = frequency_of(t);
    if (t->turns < 2) return frequency;
    ts_real period = (t->last - t->first) / (ts_real)(t->turns - 1), order = frequency * period;
    if (!(order >= 0 && order < orders)) return frequency;
    if (!(size_of(order - (ts_real)(int)(order + (ts_real)0.5)) > off)) return 0;
    ts_real apart = 2 * period / (ts_real)t->block, beside = size_of(order - 1);
    for (int turns = 1; turns <= MOST_TURNS; turns++)
        if (!(size_of(beside - (ts_real)turns * apart) > OFF_MOTION)) return 0;
    return frequency;
}

ts_real ts_tone_amplitude(const ts_tone *t)
{
    return t->blocks > 2 ? 2 * root_of(t->power[0] / (ts_real)(t->blocks - 2)) / (ts_real)t->block : 0;
}
