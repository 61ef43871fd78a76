/* Hum: sines of known frequency that come from outside. The law learns from a measurement without them. */
#include "controller.h"

#define HUM_FOLLOWED 20               /* 1/s: how fast their amplitudes follow */
#define HUM_FORGOTTEN 4               /* 1/s: how fast they decay without measurements */
#define LARGEST_HUM ((ts_real)0.02)   /* of the stroke: of one line */
#define LOUD_LINE ((ts_real)0.002)    /* of the stroke: twice a line that may have been taken for the stage */
#define NEAR_RESONANCE ((ts_real)0.5)  /* of it: from there on a line is not subtracted */
#define AS_LOUD 2                      /* times a line: a half-wave of an oscillation beside it */
#define OF_LINE ((ts_real)0.2)        /* of the frequency of a line: what is shown so near to it is the line */
#define SAME_LINE ((ts_real)0.02)     /* of the frequency of a line: a load that is so near to it is that line */
#define LOWEST_LOAD 10                 /* Hz: where the search for a load ends, */
#define NEXT_LOAD ((ts_real)0.6)      /* and how it goes down */
#define STEADY_LOAD ((ts_real)0.8)    /* as TS_STEADY_TONE, where no stage rings, but the law still learns */
#define BLOCKS_HEARD 10               /* of a centre */
#define BEGINS 5                      /* times 1 / HUM_FOLLOWED: until then the amplitudes are not known */
#define LONG_OVER ((ts_real)0.2)      /* s at that bound, after which the command drives a line, and leaves it alone */

/* Those that are named, and one that was heard. */
static int lines_of(const ts_controller *c)
{
    return c->settings->hum.lines + (c->hum.heard[2] > 0 ? 1 : 0);
}

static const ts_real *line_of(const ts_controller *c, int i)
{
    return i < c->settings->hum.lines ? c->settings->hum.line[i] : c->hum.heard;
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
    ts_real tick = c->settings->oscillation.tick, rate = HUM_FOLLOWED * tick, most = LARGEST_HUM * c->settings->stroke;
    ts_real step = (rate < 1 ? rate : 1) * innovation;
    for (int i = 0; i < lines_of(c); i++) {
        ts_real *a = h->sine[i], x = a[0] + step * h->turn[i][0], y = a[1] + step * h->turn[i][1];
        a[0] = within(x, -most, most);
        a[1] = within(y, -most, most);
        if (h->over[i] < LONG_OVER) h->over[i] = size_of(a[0]) < most && size_of(a[1]) < most ? 0 : h->over[i] + tick;
    }
}

/* Whether the amplitudes are not known yet, so many ticks ago. */
static bool begins(const ts_controller *c, uint64_t ago)
{
    uint64_t ticks = measured_ticks(c);
    return ticks < ago || (ts_real)(ticks - ago) * c->settings->oscillation.tick * HUM_FOLLOWED < BEGINS;
}

/* Mean square of the lines, um^2: beside a smaller error nothing is shown of a resonance. */
ts_real ts_power_of_hum(const ts_controller *c)
{
    ts_real sum = 0;
    for (int i = 0; i < lines_of(c); i++) {
        const ts_real *a = c->hum.sine[i];
        sum += (a[0] * a[0] + a[1] * a[1]) / 2;
    }
    return sum;
}

/* Whether an oscillation of this frequency, cycles per tick, and amplitude, um, is a line. */
bool ts_is_hum(const ts_controller *c, ts_real frequency, ts_real amplitude)
{
    const ts_settings *s = c->settings;
    for (int i = 0; i < lines_of(c); i++) {
        const ts_real *a = c->hum.sine[i];
        ts_real line = line_of(c, i)[2] * s->oscillation.tick / (2 * TS_PI);
        if (size_of(frequency / line - 1) < OF_LINE && amplitude < AS_LOUD * root_of(a[0] * a[0] + a[1] * a[1])) return true;
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
        const ts_real *a = c->hum.sine[i];
        ts_real size = root_of(a[0] * a[0] + a[1] * a[1]);
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
        if (!(c->hum.over[i] < LONG_OVER) || is_near_resonance(c, line_of(c, i))) continue;
        ts_real turn[2] = {c->hum.turn[i][0], c->hum.turn[i][1]}, w = line_of(c, i)[2];
        for (uint64_t tick = measured_ticks(c); tick <= c->counters.commands; tick++) rotate(turn, line_of(c, i));
        const ts_real *a = c->hum.sine[i];
        ts_real now = a[0] * turn[0] + a[1] * turn[1], quarter = a[1] * turn[0] - a[0] * turn[1];
        sum += now;
        *ahead += first * (w * quarter) - second * (w * w * now);
    }
    return sum;
}

/* A load of this frequency, cycles per tick, and amplitude, um, is from now on a line, if it is none yet, and the one that was heard before
 * is not as loud. */
static void hear_load(ts_controller *c, ts_real frequency, ts_real amplitude)
{
    int heard = c->settings->hum.lines;
    ts_real w = 2 * TS_PI * frequency / c->settings->oscillation.tick, g = ts_tangent(TS_PI * frequency), all = 1 + g * g;
    const ts_real *a = c->hum.sine[heard], line[3] = {(1 - g * g) / all, 2 * g / all, w};
    ts_real before = c->hum.heard[2] > 0 ? root_of(a[0] * a[0] + a[1] * a[1]) : 0;
    if (is_near_resonance(c, line) || amplitude < AS_LOUD * before || amplitude > LARGEST_HUM * c->settings->stroke) return;
    for (int i = 0; i < lines_of(c); i++)
        if (size_of(w / line_of(c, i)[2] - 1) < SAME_LINE) return;
    memcpy(c->hum.heard, line, sizeof line);
    c->hum.sine[heard][0] = c->hum.sine[heard][1] = c->hum.over[heard] = 0;
}

/* One tick of the search for a load, where the settings know the stage: from half of its resonance downwards, each centre for 20 periods.
 * error: measured less desired, um. */
void ts_listen(ts_controller *c, ts_real error, ts_real zdot_d)
{
    const ts_settings *s = c->settings;
    ts_hum_state *h = &c->hum;
    if ((!s->dynamics.known && !(s->resonance > 0)) || s->trim > 0) return;
    bool anew = !(h->centre > 0);
    if (!anew && h->tone.blocks >= BLOCKS_HEARD) {
        ts_real shown = ts_tone_of_load(&h->tone, STEADY_LOAD);
        if (shown > 0) hear_load(c, shown, ts_tone_amplitude(&h->tone));
        h->centre *= NEXT_LOAD;
        anew = true;
    }
    if (h->centre < LOWEST_LOAD * s->oscillation.tick) h->centre = NEAR_RESONANCE * first_resonance(c);
    if (anew) ts_tone_begin(&h->tone, h->centre);
    ts_tone_tick(&h->tone, error, zdot_d);
}
