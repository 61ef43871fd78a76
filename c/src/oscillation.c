#include "lanes.h"

#define COLD ((ts_real)0.2)      /* s: with the first covariance an oscillation grows fivefold in a half-wave */
#define FASTER ((ts_real)2.5)    /* times as fast as the motion: a slower ringing is its error */
#define WITHOUT_FIRST 7                  /* half-waves of an oscillation that grows: six without the first, which may not be whole */
#define TS_LONGEST_GAP 0x100000 /* ticks that count as missed at the most */

static void follow_motion(ts_oscillation *o, ts_real rate, ts_real zdot_d)
{
    ts_real change = size_of(zdot_d - o->zdot_d);
    o->speed += rate * (size_of(zdot_d) - o->speed);
    o->acceleration += rate * (change - o->acceleration);
    o->zdot_d = zdot_d;
}

static bool alike(int a, int b)
{
    int shorter = a < b ? a : b, longer = a < b ? b : a;
    return (ts_real)longer <= (ts_real)1.5 * (ts_real)shorter + 1;
}

static void keep_half_wave(ts_oscillation *o)
{
    bool regular = o->regular > 0 && alike(o->length, o->lengths[0]);
    for (int i = TS_HALF_WAVES - 1; i > 0; i--) {
        o->peaks[i] = o->peaks[i - 1];
        o->lengths[i] = o->lengths[i - 1];
    }
    o->peaks[0] = o->peak;
    o->lengths[0] = o->length;
    o->regular = !regular ? 1 : o->regular < TS_HALF_WAVES ? o->regular + 1 : TS_HALF_WAVES;
}

/* Whether a half-wave has ended in this tick; those before it are kept. */
static bool follow_half_waves(ts_oscillation *o, ts_real h, ts_real threshold, ts_real longest)
{
    ts_real size = size_of(h);
    bool opposite = o->sign > 0 ? h < -threshold : h > threshold, ended = o->sign && opposite;
    ts_real step = size_of(h - o->h) / (ts_real)(1 + o->missed);
    o->h = h;
    o->length += o->length < INT32_MAX / 2 ? 1 + o->missed : 0;
    o->missed = 0;
    if (ended) keep_half_wave(o);
    if (ended || (!o->sign && size > threshold)) {
        o->sign = h > 0 ? 1 : -1;
        o->peak = size;
        o->steepest = step;
        o->length = 0;
    } else if (o->sign && (ts_real)o->length > longest) {
        o->sign = o->regular = 0;
    } else {
        if (size > o->peak && (h > 0) == (o->sign > 0)) o->peak = size;
        if (step > o->steepest) o->steepest = step;
    }
    return ended;
}

/* Whether half-wave i is so many times as large as each of those from `from` to before `to`: an oscillation of the loop has grown up to
 * there, hum has been as large from its first half-wave on. */
static bool exceeds(const ts_oscillation *o, int i, ts_real factor, int from, int to)
{
    bool larger = true;
    for (int j = from; j < to; j++) larger = larger && o->peaks[i] >= factor * o->peaks[j];
    return larger;
}

/* How many of the half-waves before this one show an oscillation that grows so fast that it cannot wait for its end; 0:
 * none do. A jump of the error, which is steeper than a wave, does not. */
static int grows_fast(const ts_oscillation *o, const ts_oscillation_settings *s)
{
    const ts_real *A = o->peaks;
    if (o->regular >= 2 && o->peak > 2 * A[0] && exceeds(o, 0, (ts_real)1.5, 1, 6)) return 2;
    ts_real length = (ts_real)o->lengths[0], speed = TS_PI * o->peak / (length * s->tick);
    bool wave = o->steepest * length < 5 * o->peak && 4 * (ts_real)o->length > length;
    return o->regular >= 1 && o->time < COLD && wave && o->peak > (ts_real)2.5 * A[0] && exceeds(o, 0, (ts_real)1.1, 1, 6) && speed > 2 * o->speed
                   && speed > size_of(o->zdot_d)
               ? 1
               : 0;
}

/* How many of the half-waves that have ended show an oscillation that grows, or is large and does not decay. */
static int grows(const ts_oscillation *o, const ts_oscillation_settings *s)
{
    const ts_real *A = o->peaks;
    if (!o->found && o->regular >= 3 && A[0] >= (ts_real)1.5 * A[1] && A[1] >= (ts_real)1.5 * A[2] && exceeds(o, 1, (ts_real)1.2, 2, 6)) return 3;
    bool rises = o->regular >= (o->found ? 6 : WITHOUT_FIRST) && A[0] >= (o->found ? 3 : (ts_real)1.8) * A[5];
    rises = rises && exceeds(o, 1, (ts_real)1.2, 5, o->regular < 8 ? o->regular : 8) && exceeds(o, 2, (ts_real)1.1, 5, 6);
    for (int i = 0; i < 5; i++) rises = rises && A[i] >= (ts_real)0.75 * A[i + 1];
    if (rises) return 6;
    bool lasts = o->regular >= TS_HALF_WAVES && A[0] > s->large && A[0] >= A[TS_HALF_WAVES - 1];
    return lasts ? TS_HALF_WAVES : 0;
}

ts_real ts_oscillation_frequency(const ts_oscillation *o, int n)
{
    ts_real ticks = 0;
    for (int i = 0; i < n; i++) ticks += (ts_real)o->lengths[i];
    return (ts_real)n / (2 * ticks);
}

bool ts_oscillation_is_fast(const ts_oscillation *o, ts_real frequency)
{
    return 2 * TS_PI * frequency * o->speed >= FASTER * o->acceleration;
}

/* Faster than the motion, as large as half of its speed, and within the band of the law. */
static bool is_of_the_stage(const ts_oscillation *o, const ts_oscillation_settings *s, ts_real frequency, ts_real peak)
{
    ts_real speed = 2 * TS_PI * frequency * peak / s->tick;
    return frequency < s->corner && ts_oscillation_is_fast(o, frequency) && speed > (ts_real)0.5 * o->speed;
}

void ts_oscillation_miss(ts_oscillation *o, const ts_oscillation_settings *s, const ts_real *error)
{
    if (o->missed < TS_LONGEST_GAP) o->missed++;
    if (!error || !(s->tick > 0)) return;
    ts_real step = s->fast * size_of(*error - o->error);
    if (step > o->steepest) o->steepest = step;
    o->error = *error;
}

ts_real ts_oscillation_tick(ts_oscillation *o, const ts_oscillation_settings *s, ts_real error, ts_real zdot_d,
                            ts_real noise, bool learned)
{
    if (!o->started) {
        o->started = true;
        o->fast = o->slow = error;
        o->zdot_d = zdot_d;
    }
    follow_motion(o, s->motion_rate, zdot_d);
    o->error = error;
    if (o->time < COLD) o->time += s->tick * (ts_real)(1 + o->missed);
    o->fast += s->fast * (error - o->fast);
    o->slow += s->slow * (o->fast - o->slow);
    o->slower += s->slow * (o->fast - o->slow - o->slower);
    ts_real threshold = s->noise_share * noise, least = s->floor / 3;
    if (threshold < least) threshold = least;
    bool ended = follow_half_waves(o, o->fast - o->slow - o->slower, threshold, 10 / s->corner);
    int n = ended ? grows(o, s) : o->sign && !o->found ? grows_fast(o, s) : 0;
    ts_real peak = ended ? o->peaks[0] : o->peak;
    if (n == 0 || !(peak > s->floor)) return 0;
    if (o->peaks[n - 1] > 5 * s->large || size_of(o->slow) > 10 * s->large) return 0; /* it begins small and on the way */
    ts_real frequency = ts_oscillation_frequency(o, n);
    if (n < (learned ? 6 : 2) && 3 * frequency > s->corner) return 0; /* a high one has many half-waves before it is large */
    return is_of_the_stage(o, s, frequency, peak) ? frequency : 0;
}
