#include "lanes.h"

#include <math.h>
#include <stddef.h>

#define ALIKE ((ts_real)2e-3)     /* of the peak-to-peak: what may be left of two periods that are alike, rms, */
#define FORM ((ts_real)0.01)      /* and of one that has the learned form */
#define PACED ((ts_real)0.02)     /* the same of two that differ by their period, */
#define APART ((ts_real)0.003)    /* by so much of it at least */
#define LEFT ((ts_real)0.05)      /* of the peak-to-peak: a motion that is further from its shape does not repeat it */
#define PULLED ((ts_real)0.5)     /* of a shift that is corrected in the next period, */
#define INTEGRATED ((ts_real)0.2) /* and of it for good */
#define EARLIER ((ts_real)0.015)  /* of the period, by which it may differ from the given one */
#define REPEATED 2                /* periods that are alike before it is a repetition, */
#define WANDERS 6                 /* and where each is earlier or later than the last one, as of a period that wanders */
#define LARGEST 10                /* of the ratios of the settings */
#define EXACT ((ts_real)1e-6)     /* samples: a shift that is rounding */
#define PER_TURN ((ts_real)0.63661977236758134308) /* 4 / (2 pi): a quarter of an angle in turns */

static ts_real clamped(ts_real x, ts_real low, ts_real high)
{
    return x < low ? low : x > high ? high : x;
}

/* ---- The motion ------------------------------------------------------------------------------------------------------ */

static ts_real told(const ts_repetition *r)
{
    return (ts_real)r->settings->size / r->settings->period;
}

/* Whether a motion can be compared with the learned one. */
static bool can_join(const ts_repetition_settings *s)
{
    const ts_learned_period *l = s->learned;
    const ts_shape *h = &l->shape;
    ts_real length = s->cosine * s->cosine + s->sine * s->sine, first = h->cosine * h->cosine + h->sine * h->sine;
    bool good = h->span > 0 && h->power > 0 && h->slopes >= 0 && first > 0 && l->gain > 0;
    return good && size_of(length - 1) < EXACT && s->ratio >= 1 && s->ratio <= LARGEST;
}

bool ts_repetition_init(ts_repetition *r, const ts_repetition_settings *settings, ts_real *memory)
{
    const ts_repetition_settings *s = settings;
    bool good = s->size >= TS_SHORTEST_PERIOD && s->size <= TS_LONGEST_PERIOD && size_of(s->period - (ts_real)s->size) <= 1 + EARLIER * (ts_real)s->size;
    good = good && s->change >= 1 && s->change <= TS_LARGEST && s->share >= 0 && s->share <= 1 && s->settles >= 0;
    if (s->learned != NULL) good = good && can_join(s);
    if (!good) return false;
    *r = (ts_repetition){.settings = settings, .now = memory, .other = memory + s->size, .amplitude = 1, .changed = 1};
    r->pace = r->step = told(r);
    r->kept = s->learned != NULL ? s->learned->level : 0;
    return true;
}

static void begin_motion(ts_repetition *r)
{
    r->repeats = r->aligned = r->begun = r->whole = false;
    r->alike = 0;
    r->shape.wave = NULL;
    r->amplitude = 1;
    r->offset = r->drift = 0;
}

void ts_repetition_leave(ts_repetition *r)
{
    begin_motion(r);
    if (!r->joined) return;
    r->joined = false;
    r->kept = r->goal;
    (void)ts_repetition_become(r, NULL, 0, r->settings->settles);
    ts_repetition_move(r, 0, r->settings->change);
}

/* The largest shift, samples: a trigger is up to a tick late. */
static ts_real largest_shift(const ts_repetition *r)
{
    return EARLIER * (ts_real)r->settings->size + (r->triggered ? 1 : 0);
}

/* The pace by which a shift in the last period is gone after the next one. */
static void follow_phase(ts_repetition *r, ts_real shift)
{
    bool locked = r->repeats || r->triggered;
    if (size_of(shift) < (locked ? EXACT : EARLIER)) { /* so that whole ticks stay whole */
        r->step = r->pace;
        return;
    }
    ts_real share = shift / (ts_real)r->settings->size, low = (1 - EARLIER) * told(r), high = (1 + EARLIER) * told(r);
    if (locked) {
        r->pace = clamped(r->pace * (1 + INTEGRATED * share), low, high);
        r->step = r->pace * (1 + PULLED * share);
    } else { /* the shift since the last period is that of one period */
        r->pace = r->step = clamped(r->pace * (1 + share), low, high);
    }
}

/* The period that was recorded is the shape. */
static void adopt(ts_repetition *r)
{
    ts_real *wave = r->now, n = (ts_real)r->settings->size;
    int last = r->settings->size - 1;
    ts_real a = (wave[1] - wave[last]) / 2, b = (wave[0] - wave[last - 1]) / 2;
    r->now = r->other;
    r->other = wave;
    r->shape = (ts_shape){wave, r->first + r->sum / n, r->high - r->low, r->squares - r->sum * (r->sum / n),
                          r->slopes + a * a + b * b, r->fundamental[0], r->fundamental[1]};
    r->amplitude = 1;
    r->offset = r->drift = 0;
}

/* Angle of a vector of length 1, in turns, -0.25..0.75. */
static ts_real turns_of(ts_real c, ts_real s)
{
    ts_real turns = 0;
    if (c < 0) {
        c = -c;
        s = -s;
        turns = (ts_real)0.5;
    }
    ts_real t = s / (1 + c); /* tangent of half of the angle, */
    t = t / (1 + root_of(1 + t * t)); /* and of a quarter: at most that of 22.5 degrees */
    ts_real t2 = t * t;
    return turns + PER_TURN * t * (1 + t2 * ((ts_real)(-1.0 / 3) + t2 * ((ts_real)0.2 + t2 * ((ts_real)(-1.0 / 7) + t2 * (ts_real)(1.0 / 9)))));
}

/* The phase of a motion that repeats becomes that of the learned one, whose shape it is compared with from now on. */
static void align(ts_repetition *r)
{
    const ts_shape *learned = &r->settings->learned->shape;
    int size = r->settings->size;
    ts_real own = root_of(r->shape.cosine * r->shape.cosine + r->shape.sine * r->shape.sine);
    ts_real its = root_of(learned->cosine * learned->cosine + learned->sine * learned->sine);
    ts_real ratio = r->settings->ratio;
    if (!(own * ratio >= its && own <= ratio * its)) {
        ts_repetition_leave(r);
        return;
    }
    if (!r->triggered) {
        ts_real c = (learned->cosine * r->shape.cosine + learned->sine * r->shape.sine) / (own * its);
        ts_real s = (learned->sine * r->shape.cosine - learned->cosine * r->shape.sine) / (own * its);
        ts_real shift = (ts_real)size * turns_of(c, s) + r->part;
        int whole = (int)shift;
        if ((ts_real)whole > shift) whole--;
        r->part = shift - (ts_real)whole;
        r->place = (r->place + whole + size) % size;
    }
    r->amplitude = own / its;
    r->offset = r->shape.mean - r->amplitude * learned->mean;
    r->shape = *learned;
    r->begun = false;
    r->aligned = true;
}

/* What of the shape is in the period that is complete: by how many samples it is early, and how unlike it is: the change of
 * its amplitude, or the residual, rms, over the peak-to-peak; -1 where it has another shift, offset or none. Its offset may drift. */
typedef struct { ts_real shift, unlike; } seen_period;

static seen_period seen(const ts_repetition *r)
{
    const ts_shape *h = &r->shape;
    seen_period found = {0, -1};
    if (!(h->span > 0 && h->power > 0)) return found;
    ts_real n = (ts_real)r->settings->size, span = h->span * r->amplitude;
    ts_real moved = h->slopes > 0 ? r->slope / h->slopes : 0, grown = r->own / h->power;
    ts_real rest = r->square - r->error * (r->error / n) - r->own * grown - r->slope * moved;
    rest = rest > 0 ? root_of(rest / n) / span : 0;
    grown = size_of(grown / r->amplitude);
    found.shift = moved / r->amplitude;
    bool small = size_of(found.shift) <= largest_shift(r) && size_of(r->error / n) <= LEFT * span;
    if (small) found.unlike = rest > grown ? rest : grown;
    return found;
}

static void join(ts_repetition *r)
{
    const ts_learned_period *l = r->settings->learned;
    if (!ts_repetition_become(r, l->volts, r->amplitude, 0)) return;
    ts_repetition_move(r, r->kept, r->settings->change);
    r->joined = true;
}

/* A period is complete. */
static void turned(ts_repetition *r)
{
    if (r->shape.wave == NULL) {
        adopt(r);
        return;
    }
    seen_period p = seen(r);
    bool alike = p.unlike >= 0 && p.unlike <= (r->aligned || r->triggered ? FORM : ALIKE);
    if (!alike && r->repeats) {
        ts_repetition_leave(r);
        return;
    }
    if (!alike) {
        bool paced = p.unlike >= 0 && p.unlike <= PACED && size_of(p.shift) > APART * (ts_real)r->settings->size;
        if (paced && !r->triggered) follow_phase(r, p.shift); /* with its own period the next one may be alike */
        r->alike = 0;
        adopt(r);
        return;
    }
    if (!r->triggered) follow_phase(r, p.shift);
    if (r->repeats) {
        r->drift = r->error / (ts_real)r->settings->size;
        if (r->aligned && !r->joined) join(r);
        return;
    }
    r->alike++;
    adopt(r);
    bool steady = r->triggered || size_of(p.shift) < EARLIER;
    bool wanders = r->alike >= WANDERS && size_of(p.shift) < APART * (ts_real)r->settings->size;
    r->repeats = (r->alike >= REPEATED && steady) || wanders;
    if (r->repeats && r->settings->learned != NULL) align(r);
}

static void begin_period(ts_repetition *r, ts_real value)
{
    r->begun = true;
    r->error = r->own = r->slope = r->square = 0;
    r->first = r->low = r->high = value;
    r->sum = r->squares = r->slopes = 0;
    r->turned[0] = 1;
    r->turned[1] = r->fundamental[0] = r->fundamental[1] = 0;
}

static void compare(ts_repetition *r, int place, ts_real value)
{
    const ts_shape *h = &r->shape;
    int size = r->settings->size;
    ts_real x = h->wave[place], e = value - (r->offset + r->amplitude * x);
    ts_real slope = (h->wave[place + 1 < size ? place + 1 : 0] - h->wave[place > 0 ? place - 1 : size - 1]) / 2;
    r->error += e;
    r->own += e * (x - h->mean);
    r->slope += e * slope;
    r->square += e * e;
}

static void record(ts_repetition *r, int place, ts_real value)
{
    ts_real v = value - r->first, c = r->turned[0], s = r->turned[1];
    r->now[place] = value;
    r->sum += v;
    r->squares += v * v;
    r->low = value < r->low ? value : r->low;
    r->high = value > r->high ? value : r->high;
    if (place >= 2) {
        ts_real slope = (value - r->now[place - 2]) / 2;
        r->slopes += slope * slope;
    }
    r->fundamental[0] += v * c;
    r->fundamental[1] += v * s;
    r->turned[0] = c * r->settings->cosine - s * r->settings->sine;
    r->turned[1] = s * r->settings->cosine + c * r->settings->sine;
}

/* The value at a whole phase; whether the period is complete with it. */
static bool sample(ts_repetition *r, int place, ts_real value)
{
    if (place == 0) begin_period(r, value);
    if (!r->begun) return false;
    if (r->shape.wave != NULL) compare(r, place, value);
    if (!r->repeats) record(r, place, value);
    return place == r->settings->size - 1;
}

/* The phase of the next tick; how many whole phases lie between. */
static int advance(ts_repetition *r)
{
    int moved = 0;
    if (r->started) {
        r->part += r->step;
        moved = (int)r->part; /* above 0 */
        r->part -= (ts_real)moved;
        r->place += moved;
        if (r->place >= r->settings->size) {
            r->place -= r->settings->size;
            r->turns++;
        }
    }
    r->started = true;
    return moved;
}

/* Of one period, at the phase of the last tick, between two samples. */
static ts_real entry(const ts_repetition *r, const ts_real *values)
{
    ts_real here = values[r->place];
    if (!(r->part > 0)) return here;
    return here + r->part * (values[r->place + 1 < r->settings->size ? r->place + 1 : 0] - here);
}

bool ts_repetition_tick(ts_repetition *r, ts_real z_d)
{
    if (!(size_of(z_d) <= TS_LARGEST)) return false;
    int moved = advance(r), size = r->settings->size;
    ts_real last = r->value;
    r->value = z_d;
    if (!r->whole) { /* the value at the phase before is not known */
        r->whole = true;
        return !(r->part > 0) && sample(r, r->place, z_d);
    }
    bool changes = false;
    for (int behind = moved - 1; behind >= 0 && r->whole; behind--) {
        int place = r->place - behind;
        ts_real value = z_d - ((ts_real)behind + r->part) / r->step * (z_d - last);
        if (!sample(r, place < 0 ? place + size : place, value)) continue;
        bool aligned = r->aligned;
        turned(r);
        changes = true;
        if (aligned != r->aligned) break; /* it has another phase */
    }
    if (changes || !r->repeats) return changes;
    ts_real near = z_d - r->drift - (r->offset + r->amplitude * entry(r, r->shape.wave));
    if (size_of(near) <= LEFT * r->shape.span * r->amplitude) return false;
    ts_repetition_leave(r);
    return true;
}

void ts_repetition_trigger(ts_repetition *r)
{
    ts_real size = (ts_real)r->settings->size, behind = size - ((ts_real)r->place + r->part + r->step);
    if (behind > size / 2) behind -= size;
    if (r->triggered && size_of(behind) <= largest_shift(r)) {
        follow_phase(r, behind);
        return;
    }
    ts_repetition_leave(r);
    r->triggered = true;
    r->started = false; /* the next tick is at phase 0 */
    r->part = 0;
    r->place = 0;
}

/* ---- What is added --------------------------------------------------------------------------------------------------- */

static ts_real smooth(ts_real u)
{
    return u * u * u * (10 + u * (6 * u - 15));
}

static ts_real gain(const ts_added *a, ts_real g)
{
    return (1 - g) * a->from + g * a->to;
}

int ts_repetition_free(const ts_repetition *r)
{
    ts_real g = smooth(r->changed);
    for (int i = 0; i < 2; i++) {
        ts_real much = gain(&r->added[i], g);
        if (!(much > 0 || much < 0)) return i;
    }
    return -1;
}

bool ts_repetition_become(ts_repetition *r, const ts_real *volts, ts_real scale, int waits)
{
    int to = ts_repetition_free(r);
    for (int i = 0; i < 2; i++)
        if (volts != NULL && r->added[i].volts == volts) to = i;
    if (volts != NULL && to < 0) return false;
    ts_real g = smooth(r->changed);
    for (int i = 0; i < 2; i++) {
        r->added[i].from = gain(&r->added[i], g);
        r->added[i].to = 0;
    }
    if (volts != NULL) {
        r->added[to].volts = volts;
        r->added[to].to = scale;
    }
    r->changed = 0;
    r->corrects = true;
    r->waits = volts != NULL ? 0 : waits;
    return true;
}

void ts_repetition_move(ts_repetition *r, ts_real volts, ts_real ticks)
{
    r->goal = volts;
    r->climb = size_of(volts - r->level) / ticks;
}

static ts_real correction(ts_repetition *r)
{
    r->changed = clamped(r->changed + 1 / r->settings->change, 0, 1);
    ts_real sum = 0, g = smooth(r->changed);
    for (int i = 0; i < 2; i++) {
        ts_real much = gain(&r->added[i], g);
        if (much > 0 || much < 0) sum += much * entry(r, r->added[i].volts);
    }
    return sum;
}

static ts_real level(ts_repetition *r)
{
    r->level += clamped(r->goal - r->level, -r->climb, r->climb);
    return r->level;
}

ts_real ts_repetition_volts(ts_repetition *r, ts_real inside, ts_real low, ts_real high, ts_real slew)
{
    ts_real volts = inside;
    r->slewed = r->saturated = false;
    r->range = high - low;
    if (r->corrects) {
        ts_real sum = inside + correction(r) + level(r);
        ts_real slewed = r->commanded ? clamped(sum, r->last - slew, r->last + slew) : sum;
        volts = clamped(slewed, low, high);
        r->slewed = slewed < sum || slewed > sum;
        r->saturated = volts < slewed || volts > slewed;
        if (r->slewed || r->saturated) r->limited++;
        if (r->waits > 0) {
            r->waits--;
            r->corrects = r->waits > 0;
        }
    }
    r->commanded = true;
    r->last = volts;
    return volts;
}

bool ts_repetition_see(ts_repetition *r, ts_real error, ts_real gain_of)
{
    ts_real span = r->shape.wave != NULL ? r->shape.span * r->amplitude : -1;
    if (!(size_of(error) <= span)) { /* lost, NaN, or no displacement */
        r->errors = 0;
        r->counted = 0;
        return false;
    }
    if (!(gain_of > 0)) return true;
    r->errors += error;
    r->counted++;
    if (r->counted >= r->settings->size) {
        ts_real n = (ts_real)r->counted, goal = r->goal - r->settings->share * r->errors / (gain_of * n);
        ts_repetition_move(r, clamped(goal, -r->range, r->range), (ts_real)r->settings->size);
        r->errors = 0;
        r->counted = 0;
    }
    return true;
}
