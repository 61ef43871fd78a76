/* The command: from the desired motion to the voltage, (9) to (14), within slew and limits. */
#include "controller.h"

#include <math.h>

#define HANDS_OVER 20 /* periods of the first resonance: in them the feedback hands over what was learned after a sudden change */
#define SMOOTH 8 /* times the third difference of velocities: no more than the sum of their first ones */

/* What a stage that was found asks of the hysteresis beyond z_d in this tick, um: 1 / G up to the fourth derivative, from the last four
 * velocities. A motion at a third of the resonance turns by up to a quarter of a radian in a tick. Where the velocities are noise,
 * or jump, their differences do not fall: there two derivatives are used. */
static ts_real ahead_of_found(const ts_controller *c, ts_real zdot_d, ts_real zddot_d, uint64_t tick)
{
    const ts_motion *past[3];
    for (uint64_t i = 0; i < 3; i++) past[i] = &c->motion[(tick - 1 - i) % TS_HISTORY];
    ts_real newest = zdot_d - past[0]->zdot_d, before = past[0]->zdot_d - past[1]->zdot_d, oldest = past[1]->zdot_d - past[2]->zdot_d;
    ts_real second = newest - before, third = second - (before - oldest);
    if (SMOOTH * size_of(third) > size_of(newest) + size_of(before) + size_of(oldest))
        return c->found.lead[0] * zdot_d + c->found.lead[1] * zddot_d;
    ts_real w = 2 * TS_PI * c->stage.resonance, drag = 2 * FOUND_DAMPING / w, stiff = 1 / (w * w);
    ts_real l1, l2, l3, l4;
    ts_lead_of_dead_time(c->found.dead, &l1, &l2, &l3, &l4);
    ts_real of_change = (stiff + l1 * drag + l2) * (newest + second / 2 + third / 3);
    ts_real of_jerk = (l1 * stiff + l2 * drag + l3) * (second + third);
    ts_real of_snap = (l2 * stiff + l3 * drag + l4) * third;
    return c->found.lead[0] * zdot_d + c->settings->oscillation.tick * (of_change + of_jerk + of_snap);
}

/* What the stage's dynamics ask of it: G^-1 z_d - z_d for slow motion where they are given, or the inertia z'' / w0^2 within a
 * tenth of the stroke. */
static ts_real ahead_of(const ts_controller *c, ts_real zdot_d, ts_real zddot_d, uint64_t tick)
{
    const ts_dynamics *g = dynamics_of(c);
    if (c->found.known) return ahead_of_found(c, zdot_d, zddot_d, tick);
    if (g->known) return g->lead[0] * zdot_d + g->lead[1] * zddot_d;
    if (!(c->stage.inertia > 0) || tick == 0) return 0;
    ts_real z = c->stage.inertia * (zdot_d - c->motion[(tick - 1) % TS_HISTORY].zdot_d), most = c->settings->stroke / 10;
    return within(z, -most, most);
}

/* From the rates of this tick and of the last one, um/s^2; 0 at the first. */
static ts_real acceleration(const ts_controller *c, ts_real zdot_d)
{
    ts_real tick = c->settings->oscillation.tick;
    return c->counters.commands > 0 && tick > 0 ? (zdot_d - c->motion[last_slot(c)].zdot_d) / tick : 0;
}

/* The displacement of the known terms, um. */
ts_real ts_of_known_terms(const ts_controller *c, const ts_motion *d)
{
    ts_real u[TS_MAX_PARAMETERS];
    ts_known_terms(c->settings, &c->now, d, u);
    return dot(c->w + c->of_plays, u, c->parameters - c->of_plays);
}

/* The displacement wanted of the plays, um: (11), the stage, the trim and the bumpless transfer, less hum and the
 * known terms. */
ts_real ts_wanted_of_plays(const ts_controller *c, const ts_motion *d, ts_real known)
{
    return through_dead_zones(c->settings, d->z_d) + d->ahead + c->integral + c->feedback.sum + c->bumpless + c->handed - c->hum.subtracted - known;
}

/* (7) and its partial sums at the rate zdot_d, each within its limits; returns whether one was moved. */
bool ts_rate_dependent_slopes(ts_controller *c, ts_real zdot_d)
{
    const ts_settings *s = c->settings;
    const ts_real *w = c->w;
    bool moved = false;
    ts_real rate = s->rate_scale * zdot_d, sum = 0;
    ts_real least = s->slope_min, most = s->slope_max;
    if (s->law == TS_LAW_KALMAN) {
        ts_real of_motion = TS_IN_MOTION * s->slope_min;
        least = ts_least_slope(c, rate);
        if (least < of_motion) least = of_motion;
    }
    for (int i = 0, n = s->plays; i < n; i++) {
        ts_real w_h = *w++;
        if (s->rate_dependent[i]) w_h += rate * *w++;
        sum += w_h;
        bool inside = sum >= least && sum <= most;
        c->slopes[i] = inside ? sum : sum > most ? most : least;
        moved |= !inside;
    }
    return moved;
}

/* The output voltage: within the slew of the last one, and within the limits, whatever x is. */
static ts_real within_limits(ts_controller *c, ts_real x)
{
    const ts_settings *s = c->settings;
    ts_real last = c->counters.commands > 0 ? c->x[last_slot(c)] : c->now.play[0];
    bool number = x == x;
    if (!number) x = last;
    c->flags.slewed = x > last + s->slew || x < last - s->slew;
    if (c->flags.slewed) x = x > last ? last + s->slew : last - s->slew;
    c->flags.saturated = !number || x < s->voltage_min || x > s->voltage_max;
    if (x < s->voltage_min) return s->voltage_min;
    return x <= s->voltage_max ? x : s->voltage_max;
}

/* Displacement of the plays at the present voltage, um: the forward of the inverse, with the slopes that it last used. */
ts_real ts_sum_of_plays(const ts_controller *c)
{
    return ts_weighted_sum(c->slopes, c->now.play, c->settings->plays);
}

/* The voltage for which the model has y_d: by the plays (12), and by the slopes that states of Duhem add to theirs, first by those as the
 * voltage begins to move, then by those of its whole move. */
static ts_real inverse(const ts_controller *c)
{
    const ts_settings *s = c->settings;
    const ts_real *play = c->now.play;
    ts_real moved = 0, most = s->voltage_max - s->voltage_min, gap = c->y_d - ts_sum_of_plays(c);
    int passes = s->terms[TS_DUHEM] > 0 ? 2 : 1;
    ts_real x = 0;
    for (int pass = 0; pass < passes; pass++) {
        x = ts_play_walk(gap, c->slopes, ts_slope_of_duhem(s, &c->now, c->w, moved, gap >= 0), s->thresholds, play, s->plays);
        moved = within(x - play[0], -most, most);
    }
    return x;
}

static void write_down(ts_controller *c, ts_real x, const ts_motion *d, ts_real known)
{
    int slot = (int)(c->counters.commands % TS_HISTORY);
    c->x[slot] = x;
    c->motion[slot] = *d;
    if (c->settings->law == TS_LAW_KALMAN) c->dynamics.strain[slot] = ts_sum_of_plays(c) + known; /* according to the model */
    c->limited[slot] = c->flags.saturated || c->flags.slewed;
    ts_real speed = d->zdot_d < 0 ? -d->zdot_d : d->zdot_d;
    if (speed > c->fastest) c->fastest = speed < c->settings->velocity_limit ? speed : c->settings->velocity_limit;
    c->counters.commands++;
    c->counters.projected += c->flags.projected;
    c->counters.saturated += c->flags.saturated;
    c->counters.slewed += c->flags.slewed;
}

/* What the stage that is in the model from now on asks of the last command, too: else the next one, which has what it asks, would jump
 * by that, for `ts_keep_command` keeps what the stage before it asked. */
void ts_look_ahead_anew(ts_controller *c)
{
    ts_motion *last = &c->motion[last_slot(c)];
    if (c->counters.commands > 0) last->ahead = ahead_of(c, last->zdot_d, last->zddot_d, c->counters.commands - 1);
}

/* Bumpless transfer: the command for the last tick stays as it was; the difference decays. */
void ts_keep_command(ts_controller *c)
{
    const ts_motion *last = &c->motion[last_slot(c)];
    (void)ts_rate_dependent_slopes(c, last->zdot_d);
    if (c->counters.commands > 0) c->bumpless += ts_sum_of_plays(c) - ts_wanted_of_plays(c, last, ts_of_known_terms(c, last));
}

ts_status ts_controller_command(ts_controller *c, ts_real z_d, ts_real zdot_d, ts_real *volts)
{
    return ts_controller_follow(c, z_d, zdot_d, (ts_real)NAN, (ts_real)NAN, NULL, volts);
}

/* Whether they are finite; if so within TS_LARGEST. */
static bool take_others(ts_motion *d, const ts_real *others, int axes)
{
    bool good = true;
    for (int i = 0; others && i < 3 * axes; i++) {
        good = good && isfinite(others[i]);
        d->others[i / 3][i % 3] = within(others[i], -TS_LARGEST, TS_LARGEST);
    }
    return good;
}

ts_status ts_controller_follow(ts_controller *c, ts_real z_d, ts_real zdot_d, ts_real zddot_d, ts_real strain_d,
                               const ts_real *others, ts_real *volts)
{
    const ts_settings *s = c->settings;
    ts_motion d = {0};
    if (!isfinite(z_d) || !isfinite(zdot_d) || isinf(zddot_d) || isinf(strain_d)) return TS_NOT_FINITE;
    if (!take_others(&d, others, s->terms[TS_COUPLING])) return TS_NOT_FINITE;
    bool known_acceleration = zddot_d == zddot_d, known_strain = strain_d == strain_d && !c->found.known;
    z_d = within(z_d, -TS_LARGEST, TS_LARGEST);
    zdot_d = within(zdot_d, -TS_LARGEST, TS_LARGEST);
    zddot_d = within(zddot_d, -TS_LARGEST, TS_LARGEST);
    if (c->counters.commands - measured_ticks(c) >= (uint64_t)ts_patience(c))
        ts_pass_over(c); /* before its slot is taken */
    ts_remember_creep(&c->now, s);
    d.z_d = z_d;
    d.zdot_d = zdot_d;
    d.zddot_d = known_acceleration ? zddot_d : acceleration(c, zdot_d);
    d.ahead = known_strain ? within(strain_d, -TS_LARGEST, TS_LARGEST) - z_d : ahead_of(c, zdot_d, d.zddot_d, c->counters.commands);
    ts_real against_hum = 0;
    c->hum.subtracted = ts_hum_ahead(c, &against_hum);
    d.ahead -= against_hum;
    ts_real known = ts_of_known_terms(c, &d);
    c->y_d = ts_wanted_of_plays(c, &d, known);
    c->flags.projected = ts_rate_dependent_slopes(c, zdot_d);
    *volts = within_limits(c, ts_before_amplifier(&c->now, amplifier_of(c), inverse(c)));
    ts_remember_voltage(&c->now, s, amplifier_of(c), *volts);
    c->bumpless *= c->stage.smoothing;
    c->handed *= 1 - s->dynamics.first / HANDS_OVER;
    write_down(c, *volts, &d, s->terms[TS_DUHEM] > 0 ? ts_of_known_terms(c, &d) : known);
    return TS_OK;
}
