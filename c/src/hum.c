/* Hum: sines of known frequency that come from outside. The law learns without what has their frequencies. */
#include "controller.h"

#define HUM_FOLLOWED 20               /* 1/s: how fast their amplitudes follow */
#define HUM_FORGOTTEN 4               /* 1/s: how fast they decay without measurements */
#define LARGEST_HUM ((ts_real)0.02)   /* of the stroke: of one line */
#define LOUD_LINE ((ts_real)0.002)    /* of the stroke: twice a line that may have been taken for the stage */
#define NEAR_RESONANCE ((ts_real)0.5)  /* of it: from there on a line is not subtracted */
#define AS_LOUD 2                      /* times a line: a half-wave of an oscillation beside it */
#define OF_LINE ((ts_real)0.2)        /* of the frequency of a line: what is shown so near to it is the line */
#define SAME_LINE ((ts_real)0.02)     /* of the frequency of a line: a load that is so near to it is that line */
#define HIGHEST_LOAD 100               /* Hz, */
#define FASTEST_LOAD ((ts_real)0.1)   /* and cycles per tick: where the search for a load begins, if no resonance is known, */
#define LOWEST_LOAD 10                 /* Hz: where it ends, */
#define NEXT_LOAD ((ts_real)0.6)      /* and how it goes down, */
#define NEXT_OF_EAR ((ts_real)0.01679616)  /* that of each detector eight times as fast */
#define MEAN_OF 1                      /* s: of the mean of what the first weights explain */
#define LARGE_MOTION ((ts_real)0.1)   /* of the stroke: rms of a motion, of which a second is remembered */
#define STEADY_LOAD ((ts_real)0.8)    /* as TS_STEADY_TONE, in the error, which a law that still learns changes, */
#define STEADY_BESIDE_F0 ((ts_real)0.9)  /* and in what the first weights do not explain, where f0 alone is given */
#define ORDERS ((ts_real)20.5)         /* of a harmonic of the motion: a tone there may be of it */
#define BLOCKS_HEARD 10               /* of a centre */
#define BEGINS 5                      /* times 1 / HUM_FOLLOWED: until then the amplitudes are not known */
#define LONG_OVER ((ts_real)0.2)      /* s at that bound, after which the command drives a line, and leaves it alone */
#define JUDGED_AFTER ((ts_real)0.5)   /* s: when it is known what a line that was heard does */
#define NO_LOAD ((ts_real)0.05)       /* of the amplitude with which it was heard: a smaller one is none, */
#define DRIVEN_UP 5                   /* and so many times it that of a line that the command drives */
#define REFUSED_FOR 5                 /* s: how long a line that was dropped is not heard again, */
#define NEAR_REFUSED ((ts_real)0.1)   /* nor one so near to it, of its frequency */
#define HIGHEST_BEYOND ((ts_real)0.42) /* cycles per tick: where the search for a line beyond the resonance begins, */
#define LOWEST_BEYOND ((ts_real)2.2)   /* times the first resonance of given dynamics: where it ends, */
#define NEXT_BEYOND ((ts_real)0.7)     /* and how it goes down */
#define MOST_LOADS 2                   /* that are heard at the same time; the others of TS_HEARD are beyond the resonance */
#define TIME_BEYOND ((ts_real)0.02)    /* s of a centre, at least */
#define STEADY_BEYOND ((ts_real)2.4)   /* as TS_STEADY_TONE, over the root of the blocks: noise has more in one window of a hundred, */
#define LEAST_STEADY ((ts_real)0.4)    /* and at least */
#define BLOCKS_BEYOND 9                /* of a centre, at least */
#define AUDIBLE_BEYOND ((ts_real)0.3)  /* times the noise of the law */
#define LEAST_BEYOND ((ts_real)0.1)    /* share of the mean square of the error */
#define SAME_BEYOND ((ts_real)0.05)    /* of the frequency of such a line: what is heard so near to it is that line */
#define WIDTH_BEYOND ((ts_real)0.02)   /* of 2 pi times its frequency: how fast the amplitude of such a line follows */

/* Those that are named, and those that were heard. */
static int lines_of(const ts_controller *c)
{
    int heard = 0;
    while (heard < TS_HEARD && c->hum.heard[heard].line[2] > 0) heard++;
    return c->settings->hum.lines + heard;
}

static const ts_real *line_of(const ts_controller *c, int i)
{
    return i < c->settings->hum.lines ? c->settings->hum.line[i] : c->hum.heard[i - c->settings->hum.lines].line;
}

/* Whether it was heard beyond the resonance: what the dynamics do not explain there, such as a further mode, is no load. */
static bool is_beyond(const ts_controller *c, int i)
{
    return i >= c->settings->hum.lines && c->hum.heard[i - c->settings->hum.lines].beyond > 0;
}

/* Share per tick by which a line is followed, `times` as fast as its amplitude. */
static ts_real share_of(const ts_controller *c, int i, ts_real times)
{
    ts_real faster = is_beyond(c, i) ? WIDTH_BEYOND * line_of(c, i)[2] : 0;
    ts_real share = times * (faster > HUM_FOLLOWED ? faster : HUM_FOLLOWED) * c->settings->oscillation.tick;
    return share < 1 ? share : 1;
}

/* Of cosine and sine, um. */
static ts_real amplitude_of(const ts_real *a)
{
    return root_of(a[0] * a[0] + a[1] * a[1]);
}

/* Amplitude of a line, um. */
static ts_real size_of_line(const ts_controller *c, int i)
{
    return amplitude_of(c->hum.sine[i]);
}

/* One tick of a phasor; its length stays one. */
static void rotate(ts_real *turn, const ts_real *line)
{
    ts_real cosine = turn[0] * line[0] - turn[1] * line[1], sine = turn[1] * line[0] + turn[0] * line[1];
    ts_real unit = (ts_real)1.5 - (cosine * cosine + sine * sine) / 2;
    turn[0] = unit * cosine;
    turn[1] = unit * sine;
}

void ts_hum_begin(ts_hum_state *h)
{
    for (int i = 0; i < TS_LINES; i++) h->turn[i][0] = 1;
}

/* Other lines than before: each begins anew. */
void ts_hum_anew(ts_hum_state *h)
{
    memset(h->sine, 0, sizeof h->sine);
    memset(h->over, 0, sizeof h->over);
    memset(h->heard, 0, sizeof h->heard);
    memset(h->refused, 0, sizeof h->refused);
    memset(h->regressor, 0, sizeof h->regressor);
    memset(h->measurement, 0, sizeof h->measurement);
}

/* The next tick that is measured, or passed over. */
void ts_hum_tick(ts_controller *c)
{
    for (int i = 0; i < lines_of(c); i++) rotate(c->hum.turn[i], line_of(c, i));
}

/* A tick without a measurement: a frequency that is a little off takes the phase away, so that the amplitudes decay. */
void ts_hum_miss(ts_controller *c)
{
    ts_real rate = HUM_FORGOTTEN * c->settings->oscillation.tick, kept = rate < 1 ? 1 - rate : 0;
    ts_hum_tick(c);
    for (int i = 0; i < lines_of(c); i++) {
        c->hum.sine[i][0] *= kept;
        c->hum.sine[i][1] *= kept;
    }
}

/* In the measurement of this tick, um. */
ts_real ts_hum_of(const ts_controller *c)
{
    const ts_hum_state *h = &c->hum;
    ts_real sum = 0;
    for (int i = 0; i < lines_of(c); i++) sum += h->sine[i][0] * h->turn[i][0] + h->sine[i][1] * h->turn[i][1];
    return sum;
}

/* What the model did not expect of this tick, um, is hum as far as it has its frequency. */
void ts_hum_follow(ts_controller *c, ts_real innovation)
{
    ts_hum_state *h = &c->hum;
    ts_real tick = c->settings->oscillation.tick;
    for (int i = 0; i < lines_of(c); i++) {
        ts_real most = (is_beyond(c, i) ? 1 : LARGEST_HUM) * c->settings->stroke;
        ts_real step = share_of(c, i, 1) * innovation;
        ts_real *a = h->sine[i], x = a[0] + step * h->turn[i][0], y = a[1] + step * h->turn[i][1];
        a[0] = within(x, -most, most);
        a[1] = within(y, -most, most);
        if (h->over[i] < LONG_OVER) h->over[i] = size_of(a[0]) < most && size_of(a[1]) < most ? 0 : h->over[i] + tick;
    }
}

/* The same canceller takes each line out of a regressor, in `space`, and out of what belongs to it: their linear relation stays, without
 * what the command does against the line. */
const ts_real *ts_without_hum(ts_controller *c, const ts_real *u, ts_real *y, ts_real *space)
{
    for (int l = 0; l < lines_of(c); l++, u = space) {
        ts_real rate = share_of(c, l, 2), *of_y = c->hum.measurement[l], cosine = c->hum.turn[l][0], sine = c->hum.turn[l][1];
        for (int i = 0; i < c->parameters; i += TS_LANES) {
            ts_real *a = c->hum.regressor[l][0] + i, *b = c->hum.regressor[l][1] + i;
            lanes alone = minus(minus(load(u + i), cosine, load(a)), sine, load(b));
            store(a, plus(load(a), rate * cosine, alone));
            store(b, plus(load(b), rate * sine, alone));
            store(space + i, alone);
        }
        *y = *y - cosine * of_y[0] - sine * of_y[1];
        of_y[0] += rate * cosine * *y;
        of_y[1] += rate * sine * *y;
    }
    return u;
}

/* The error that is fed back, um: without what is beyond the resonance, where the margins of the feedback are not known. */
ts_real ts_without_beyond(ts_controller *c, ts_real error)
{
    int named = c->settings->hum.lines;
    for (int i = named; i < lines_of(c); i++) {
        if (!is_beyond(c, i)) continue;
        ts_real rate = share_of(c, i, 2), *of = c->hum.heard[i - named].fed_back, *turn = c->hum.turn[i];
        error = error - turn[0] * of[0] - turn[1] * of[1];
        of[0] += rate * turn[0] * error;
        of[1] += rate * turn[1] * error;
    }
    return error;
}

/* Whether the amplitudes are not known yet, so many ticks ago. */
static bool begins(const ts_controller *c, uint64_t ago)
{
    uint64_t ticks = measured_ticks(c);
    return ticks < ago || (ts_real)(ticks - ago) * c->settings->oscillation.tick * HUM_FOLLOWED < BEGINS;
}

/* Mean square of the lines but those beyond the resonance, um^2: beside a smaller error nothing is shown of a resonance. */
ts_real ts_power_of_hum(const ts_controller *c)
{
    ts_real sum = 0;
    for (int i = 0; i < lines_of(c); i++) {
        const ts_real *a = c->hum.sine[i];
        if (!is_beyond(c, i)) sum += (a[0] * a[0] + a[1] * a[1]) / 2;
    }
    return sum;
}

/* Whether an oscillation of this frequency, cycles per tick, and amplitude, um, is a line; one beyond the resonance may be the stage. */
bool ts_is_hum(const ts_controller *c, ts_real frequency, ts_real amplitude)
{
    const ts_settings *s = c->settings;
    for (int i = 0; i < lines_of(c); i++) {
        ts_real line = line_of(c, i)[2] * s->oscillation.tick / (2 * TS_PI);
        if (!is_beyond(c, i) && size_of(frequency / line - 1) < OF_LINE && amplitude < AS_LOUD * size_of_line(c, i)) return true;
    }
    return false;
}

/* When the amplitudes are known: what was taken for the stage before is forgotten where it is the loudest line. */
void ts_forget_hum(ts_controller *c)
{
    const ts_settings *s = c->settings;
    bool given = s->resonance > 0 || s->dynamics.known;
    if (lines_of(c) == 0 || given || !(c->stage.resonance > 0) || begins(c, 0) || !begins(c, 1)) return;
    ts_real most = LOUD_LINE * s->stroke;
    for (int i = 0; i < lines_of(c); i++) {
        ts_real size = size_of_line(c, i);
        if (size > most) most = size;
    }
    if (!ts_is_hum(c, c->stage.resonance, most)) return;
    ts_forget_stage(c);
    ts_keep_command(c);
}

/* The first resonance of the stage, cycles per tick; 0: it is not known. */
static ts_real first_resonance(const ts_controller *c)
{
    return is_given(c) ? c->settings->dynamics.first : c->stage.resonance;
}

/* Near the resonance, or above it, the model does not know enough of what the stage makes of a command. */
static bool is_near_resonance(const ts_controller *c, const ts_real *line)
{
    ts_real turns = line[2] * c->settings->oscillation.tick / (2 * TS_PI), resonance = first_resonance(c);
    return resonance > 0 && turns > NEAR_RESONANCE * resonance;
}

/* What a command that takes hum away subtracts from the displacement, um, and by `ahead` from what the stage asks beyond that. A feedback
 * that has resonators takes it away itself. */
ts_real ts_hum_ahead(const ts_controller *c, ts_real *ahead)
{
    const ts_settings *s = c->settings;
    const ts_dynamics *g = dynamics_of(c);
    ts_real first = g->known ? g->lead[0] : 0;
    ts_real second = g->known ? g->lead[1] : c->stage.inertia * s->oscillation.tick, sum = 0;
    *ahead = 0;
    if (begins(c, 0)) return 0;
    for (int i = is_given(c) && s->feedback.filters > 0 ? s->hum.lines : 0; i < lines_of(c); i++) {
        if (!(c->hum.over[i] < LONG_OVER) || is_beyond(c, i) || is_near_resonance(c, line_of(c, i))) continue;
        ts_real turn[2] = {c->hum.turn[i][0], c->hum.turn[i][1]}, w = line_of(c, i)[2];
        for (uint64_t tick = measured_ticks(c); tick <= c->counters.commands; tick++) rotate(turn, line_of(c, i));
        const ts_real *a = c->hum.sine[i];
        ts_real now = a[0] * turn[0] + a[1] * turn[1], quarter = a[1] * turn[0] - a[0] * turn[1];
        sum += now;
        *ahead += first * (w * quarter) - second * (w * w * now);
    }
    return sum;
}

/* Amplitude, um, which another line has to exceed by far that takes the place of this one. What is beyond the resonance may be quiet since
 * it is kept from law and feedback. */
static ts_real loudness_of(const ts_controller *c, int i)
{
    ts_real size = size_of_line(c, i), announced = is_beyond(c, i) ? c->hum.heard[i - c->settings->hum.lines].announced : 0;
    return size > announced ? size : announced;
}

/* The place of a line that is heard: a free one, or, where as many of its kind were heard before as can be, that of the quietest of them. */
static int place_of(const ts_controller *c, bool beyond)
{
    int of_kind = 0, quietest = 0, most = beyond ? TS_HEARD - MOST_LOADS : MOST_LOADS;
    for (int i = c->settings->hum.lines; i < lines_of(c); i++) {
        if (is_beyond(c, i) != beyond) continue;
        if (of_kind++ == 0 || loudness_of(c, i) < loudness_of(c, quietest)) quietest = i;
    }
    return of_kind < most ? lines_of(c) : quietest;
}

/* Whether a line of this frequency, 1/s, was dropped not long ago. */
static bool is_refused(const ts_hum_state *h, ts_real w)
{
    for (int i = 0; i < TS_HEARD; i++)
        if (h->refused[i][1] > 0 && size_of(w / h->refused[i][0] - 1) < NEAR_REFUSED) return true;
    return false;
}

/* A line beyond the resonance that is heard again, louder: the louder, the better its frequency is known. */
static void tune(ts_load *l, const ts_load *heard)
{
    if (!(heard->announced > l->announced)) return;
    memcpy(l->line, heard->line, sizeof l->line);
    l->announced = heard->announced;
}

/* What has this frequency, cycles per tick, and amplitude, um, is from now on a line, if it is none yet, and louder than the noise. Where it
 * takes the place of another it is twice as loud. */
static void hear(ts_controller *c, ts_real frequency, ts_real amplitude, bool beyond)
{
    ts_hum_state *h = &c->hum;
    int place = place_of(c, beyond);
    ts_real w = 2 * TS_PI * frequency / c->settings->oscillation.tick, g = ts_tangent(TS_PI * frequency), all = 1 + g * g;
    const ts_load heard = {.line = {(1 - g * g) / all, 2 * g / all, w}, .announced = amplitude, .beyond = beyond};
    bool audible = amplitude > (beyond ? AUDIBLE_BEYOND : 1) * c->law.kalman.sigma && amplitude <= (beyond ? 1 : LARGEST_HUM) * c->settings->stroke;
    if (!audible || (!beyond && is_near_resonance(c, heard.line)) || is_refused(h, w)) return;
    for (int i = 0; i < lines_of(c); i++) {
        if (!(size_of(w / line_of(c, i)[2] - 1) < (is_beyond(c, i) ? SAME_BEYOND : SAME_LINE))) continue;
        if (is_beyond(c, i)) tune(&h->heard[i - c->settings->hum.lines], &heard);
        return;
    }
    if (place < lines_of(c) && amplitude < AS_LOUD * loudness_of(c, place)) return;
    h->heard[place - c->settings->hum.lines] = heard;
    h->sine[place][0] = h->sine[place][1] = h->over[place] = 0;
    memset(h->regressor[place], 0, sizeof h->regressor[place]);
    h->measurement[place][0] = h->measurement[place][1] = 0;
}

/* A line that was heard is none any more. Those behind it move up. */
static void drop_line(ts_controller *c, int i)
{
    ts_hum_state *h = &c->hum;
    int named = c->settings->hum.lines, last = lines_of(c) - 1;
    memmove(h->refused[1], h->refused[0], sizeof h->refused - sizeof h->refused[0]);
    h->refused[0][0] = h->heard[i].line[2];
    h->refused[0][1] = REFUSED_FOR;
    for (int to = named + i; to < last; to++) {
        memcpy(h->turn[to], h->turn[to + 1], sizeof h->turn[to]);
        memcpy(h->sine[to], h->sine[to + 1], sizeof h->sine[to]);
        memcpy(h->regressor[to], h->regressor[to + 1], sizeof h->regressor[to]);
        memcpy(h->measurement[to], h->measurement[to + 1], sizeof h->measurement[to]);
        h->over[to] = h->over[to + 1];
        h->heard[to - named] = h->heard[to + 1 - named];
    }
    memset(&h->heard[last - named], 0, sizeof h->heard[0]);
}

/* What a signal, um, has of a line: cosine and sine, over the last 1 / HUM_FOLLOWED. */
static void demodulate(ts_real *of, const ts_real *turn, ts_real signal, ts_real rate)
{
    of[0] += rate * (2 * signal * turn[0] - of[0]);
    of[1] += rate * (2 * signal * turn[1] - of[1]);
}

/* Whether what was heard is no load: nothing is there, or the command that takes it away makes it larger. */
static bool is_no_load(const ts_load *l, ts_real size)
{
    ts_real shows = amplitude_of(l->first), remains = amplitude_of(l->error), most = size > l->announced ? size : l->announced;
    if (size > DRIVEN_UP * l->announced && remains > l->announced) return true;
    return l->age > JUDGED_AFTER && (remains > most || (size > shows ? size : shows) < NO_LOAD * l->announced);
}

/* One tick in which lines that were heard are judged by the signals in which they were. */
static void judge_lines(ts_controller *c, const ts_real *signals)
{
    ts_hum_state *h = &c->hum;
    int named = c->settings->hum.lines;
    ts_real tick = c->settings->oscillation.tick, rate = HUM_FOLLOWED * tick < 1 ? HUM_FOLLOWED * tick : 1;
    for (int i = 0; i < TS_HEARD; i++)
        if (h->refused[i][1] > 0) h->refused[i][1] -= tick;
    for (int i = lines_of(c) - named - 1; i >= 0; i--) {
        ts_load *l = &h->heard[i];
        demodulate(l->first, h->turn[named + i], signals[0], rate);
        demodulate(l->error, h->turn[named + i], signals[1], rate);
        l->age += tick;
        /* beyond the resonance it may be quiet since the feedback no longer drives it; of other dynamics it is none */
        if (l->beyond > 0 ? !is_given(c) : is_no_load(l, size_of_line(c, named + i))) drop_line(c, i);
    }
}

/* What a measurement has beside a straight line of the plays with their first weights, um: a load that the law follows is in it, too.
 * The line is that of motion that no load makes. */
static ts_real unexplained(ts_controller *c, ts_real z, bool used)
{
    const ts_settings *s = c->settings;
    ts_unexplained *f = &c->hum.unexplained;
    ts_real tick = s->oscillation.tick, rate = tick / MEAN_OF, least = LARGEST_HUM * s->stroke, large = LARGE_MOTION * s->stroke, expected = 0;
    for (int i = 0, at = 0; i < s->plays; at += 1 + s->rate_dependent[i++]) expected += c->kept.first[at] * c->lagged.play[i];
    if (!(f->square > 0)) {
        f->expected = expected;
        f->z = z;
        f->square = f->product = least * least * tick;
    }
    if (used) {
        f->expected += (rate < 1 ? rate : 1) * (expected - f->expected);
        f->z += (rate < 1 ? rate : 1) * (z - f->z);
    }
    ts_real x = within(expected - f->expected, -TS_LARGEST, TS_LARGEST), y = within(z - f->z, -TS_LARGEST, TS_LARGEST);
    if (used && size_of(x) > least) {
        f->square += tick * x * x;
        f->product += tick * x * y;
        ts_real most = large * large, kept = f->square > most ? most / f->square : 1;
        f->square *= kept;
        f->product *= kept;
    }
    return y - f->product / f->square * x;
}

/* Whether loads are listened for in what the first weights do not explain, too: where it is given, no load is taken for the stage. Beside
 * other axes their motion is in that, whose harmonics are not those of this axis. */
static bool explains(const ts_controller *c)
{
    return (c->settings->dynamics.known || c->settings->resonance > 0) && c->settings->terms[TS_COUPLING] == 0;
}

/* How steady a tone is a load, in the error or not. */
static ts_real steady_load(const ts_controller *c, bool of_error)
{
    if (of_error) return STEADY_LOAD;
    return c->settings->dynamics.known ? TS_STEADY_TONE : STEADY_BESIDE_F0;
}

/* One tick of a detector, whose centres begin at `first`, cycles per tick, and end at `lowest`; each time it begins again it is that of the
 * other signal. */
static void listen_about(ts_controller *c, ts_ear *e, ts_real first, ts_real lowest, const ts_real *signals, ts_real zdot_d)
{
    bool anew = !(e->centre > 0);
    if (!anew && e->tone.blocks >= BLOCKS_HEARD) {
        bool of_error = e->of_error > 0 || !explains(c);
        ts_real shown = ts_tone_of_load(&e->tone, steady_load(c, of_error), ORDERS, TS_OFF_HARMONIC);
        if (shown > 0) hear(c, shown, ts_tone_amplitude(&e->tone), false);
        e->centre *= NEXT_OF_EAR;
        if (e->centre < lowest) e->of_error = 1 - e->of_error;
        anew = true;
    }
    if (e->centre < lowest) e->centre = first;
    if (anew) ts_tone_begin(&e->tone, e->centre);
    ts_tone_tick(&e->tone, signals[e->of_error], zdot_d);
}

/* A tone that was looked for beyond the resonance is a line where it matters. */
static void hear_beyond(ts_controller *c, const ts_ear *e, ts_real lowest)
{
    ts_real noise = STEADY_BEYOND / root_of((ts_real)e->tone.blocks), amplitude = ts_tone_amplitude(&e->tone);
    ts_real shown = ts_tone_of_load(&e->tone, noise > LEAST_STEADY ? noise : LEAST_STEADY, 0, TS_OFF_HARMONIC);
    ts_real share = amplitude * amplitude / 2 * (ts_real)e->tone.passed;
    if (shown > lowest && share > LEAST_BEYOND * e->power) hear(c, shown, amplitude, true);
}

/* One tick of the search for a line beyond the resonance of given dynamics, in the error. There a harmonic of the motion is one, too: what a
 * further mode makes of it. */
static void listen_beyond(ts_controller *c, ts_real error, ts_real zdot_d)
{
    ts_ear *e = &c->hum.beyond;
    ts_real lowest = LOWEST_BEYOND * first_resonance(c), passed = (ts_real)e->tone.passed * c->settings->oscillation.tick;
    if (!(lowest < HIGHEST_BEYOND)) return;
    bool anew = !(e->centre > 0);
    if (!anew && e->tone.blocks >= BLOCKS_BEYOND && passed >= TIME_BEYOND) {
        hear_beyond(c, e, lowest);
        e->centre *= NEXT_BEYOND;
        anew = true;
    }
    if (e->centre < lowest) e->centre = HIGHEST_BEYOND;
    if (anew) {
        ts_tone_begin(&e->tone, e->centre);
        e->power = 0;
    }
    e->power += error * error;
    ts_tone_tick(&e->tone, error, zdot_d);
}

/* One tick of the search for a load: each detector has every eighth centre, for 20 periods each, from half of the first resonance downwards,
 * or, where it is not known, from HIGHEST_LOAD. error: measured z less desired, um. */
void ts_listen(ts_controller *c, ts_real error, ts_real z, ts_real zdot_d, bool used)
{
    ts_real tick = c->settings->oscillation.tick, first = NEAR_RESONANCE * first_resonance(c), lowest = LOWEST_LOAD * tick;
    if (c->settings->trim > 0) return;
    if (!(first > 0)) first = within(HIGHEST_LOAD * tick, 0, FASTEST_LOAD);
    const ts_real signals[2] = {explains(c) ? unexplained(c, z, used) : error, error};
    if (used) judge_lines(c, signals);
    if (is_given(c)) listen_beyond(c, error, zdot_d);
    for (int i = 0; i < TS_EARS; i++) {
        if (first >= lowest) listen_about(c, &c->hum.ear[i], first, lowest, signals, zdot_d);
        first *= NEXT_LOAD;
    }
}
