/* Hum: sines of known frequency that come from outside. The law learns from a measurement without them. */
#include "controller.h"

#define HUM_FOLLOWED 20               /* 1/s: how fast their amplitudes follow */
#define LARGEST_HUM ((ts_real)0.02)   /* of the stroke: of one line */
#define LOUD_LINE ((ts_real)0.002)    /* of the stroke: twice a line that may have been taken for the stage */
#define NEAR_RESONANCE ((ts_real)0.5)  /* of it: from there on a line is not subtracted */
#define AS_LOUD 2                      /* times a line: a half-wave of an oscillation beside it */
#define OF_LINE ((ts_real)0.2)        /* of the frequency of a line: what is shown so near to it is the line */
#define BEGINS 5                      /* times 1 / HUM_FOLLOWED: until then the amplitudes are not known */
#define LONG_OVER ((ts_real)0.2)      /* s at that bound, after which the command drives a line, and leaves it alone */

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

/* The next tick that is measured, or passed over. */
void ts_hum_tick(ts_controller *c)
{
    const ts_hum *lines = &c->settings->hum;
    for (int i = 0; i < lines->lines; i++) rotate(c->hum.turn[i], lines->line[i]);
}

/* In the measurement of this tick, um. */
ts_real ts_hum_of(const ts_controller *c)
{
    const ts_hum_state *h = &c->hum;
    ts_real sum = 0;
    for (int i = 0; i < c->settings->hum.lines; i++) sum += h->sine[i][0] * h->turn[i][0] + h->sine[i][1] * h->turn[i][1];
    return sum;
}

/* What the model did not expect of this tick, um, is hum as far as it has its frequency. */
void ts_hum_follow(ts_controller *c, ts_real innovation)
{
    ts_hum_state *h = &c->hum;
    ts_real tick = c->settings->oscillation.tick, rate = HUM_FOLLOWED * tick, most = LARGEST_HUM * c->settings->stroke;
    ts_real step = (rate < 1 ? rate : 1) * innovation;
    for (int i = 0; i < c->settings->hum.lines; i++) {
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
    for (int i = 0; i < c->settings->hum.lines; i++) {
        const ts_real *a = c->hum.sine[i];
        sum += (a[0] * a[0] + a[1] * a[1]) / 2;
    }
    return sum;
}

/* Whether an oscillation of this frequency, cycles per tick, and amplitude, um, is a line. */
bool ts_is_hum(const ts_controller *c, ts_real frequency, ts_real amplitude)
{
    const ts_settings *s = c->settings;
    for (int i = 0; i < s->hum.lines; i++) {
        const ts_real *a = c->hum.sine[i];
        ts_real line = s->hum.line[i][2] * s->oscillation.tick / (2 * TS_PI);
        if (size_of(frequency / line - 1) < OF_LINE && amplitude < AS_LOUD * root_of(a[0] * a[0] + a[1] * a[1])) return true;
    }
    return false;
}

/* When the amplitudes are known: what was taken for the stage before is forgotten where it is the loudest line. */
void ts_forget_hum(ts_controller *c)
{
    const ts_settings *s = c->settings;
    bool given = s->resonance > 0 || s->dynamics.known;
    if (s->hum.lines == 0 || given || !(c->stage.resonance > 0) || begins(c, 0) || !begins(c, 1)) return;
    ts_real most = LOUD_LINE * s->stroke;
    for (int i = 0; i < s->hum.lines; i++) {
        const ts_real *a = c->hum.sine[i];
        ts_real size = root_of(a[0] * a[0] + a[1] * a[1]);
        if (size > most) most = size;
    }
    if (!ts_is_hum(c, c->stage.resonance, most)) return;
    ts_forget_stage(c);
    ts_keep_command(c);
}

/* Near the resonance, or above it, the model does not know enough of what the stage makes of a command. */
static bool is_near_resonance(const ts_controller *c, const ts_real *line)
{
    ts_real turns = line[2] * c->settings->oscillation.tick / (2 * TS_PI);
    ts_real resonance = is_given(c) ? c->settings->dynamics.first : c->stage.resonance;
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
    if ((is_given(c) && s->feedback.filters > 0) || begins(c, 0)) return 0;
    for (int i = 0; i < s->hum.lines; i++) {
        if (!(c->hum.over[i] < LONG_OVER) || is_near_resonance(c, s->hum.line[i])) continue;
        ts_real turn[2] = {c->hum.turn[i][0], c->hum.turn[i][1]}, w = s->hum.line[i][2];
        for (uint64_t tick = measured_ticks(c); tick <= c->counters.commands; tick++) rotate(turn, s->hum.line[i]);
        const ts_real *a = c->hum.sine[i];
        ts_real now = a[0] * turn[0] + a[1] * turn[1], quarter = a[1] * turn[0] - a[0] * turn[1];
        sum += now;
        *ahead += first * (w * quarter) - second * (w * w * now);
    }
    return sum;
}
