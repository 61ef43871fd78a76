#include "plant.h"

#include <math.h>
#include <string.h>

static const double two_pi = 6.283185307179586476925;

static double rounded(double x, double step)
{
    return step > 0 ? step * rint(x / step) : x;
}

static double clipped(double x, double low, double high)
{
    return x < low ? low : x > high ? high : x;
}

static double moved_play(double y, double x, double r)
{
    double low = x - r, high = x + r;
    double inner = y < high ? y : high;
    return inner > low ? inner : low;
}

/* ---- Setting up -------------------------------------------------------------------------------------------------- */

/* Thresholds at the quantiles q^e of the density exp(-r / rho) on (0, R): every play has the same weight. That weight
 * makes the chord of the loop over 0..2 R as steep as S. */
static void set_plays(ts_plant *p)
{
    const ts_plant_settings *s = &p->settings;
    double mass = -expm1(-s->threshold_max / s->threshold_scale), moving = 0;
    for (int i = 0; i < s->plays; i++) {
        double place = (i + 0.5) * pow((i + 0.5) / s->plays, s->threshold_exponent - 1);
        p->thresholds[i] = -s->threshold_scale * log1p(-mass * place / s->plays);
        moving += 1 - p->thresholds[i] / s->threshold_max;
    }
    p->play_weight = s->hysteresis * s->sensitivity / moving;
}

/* Time constants at equal steps of log time: the sum of the step responses is a straight line over log time. */
static void set_creep(ts_plant *p, double step)
{
    const ts_plant_settings *s = &p->settings;
    double decades = log10(s->creep_longest / s->creep_shortest);
    for (int j = 0; j < s->creep_operators; j++) {
        double tau = s->creep_shortest * pow(10, decades * (j + 0.5) / s->creep_operators);
        p->creep_rate[j] = -expm1(-step / tau);
    }
    p->creep_weight = s->creep * decades / s->creep_operators;
}

static void set_resonance(ts_plant *p, double step)
{
    const ts_plant_settings *s = &p->settings;
    double zeta = s->damping, root = sqrt(1 - zeta * zeta), angle = two_pi * s->resonance * step;
    double decay = exp(-zeta * angle), cosine = decay * cos(root * angle), sine = decay * sin(root * angle) / root;
    p->ring[0] = cosine + zeta * sine;
    p->ring[1] = sine;
    p->ring[2] = -sine;
    p->ring[3] = cosine - zeta * sine;
    if (s->resonance > 0 && s->amplifier_bandwidth > 0) {
        p->ring_ratio = s->amplifier_bandwidth / s->resonance;
        p->ring_gain = 1 / (1 - 2 * zeta * p->ring_ratio + p->ring_ratio * p->ring_ratio);
    }
}

void ts_plant_init(ts_plant *p, const ts_plant_settings *settings)
{
    memset(p, 0, sizeof *p);
    p->settings = *settings;
    double step = 1 / (settings->sample_rate * settings->steps_per_tick);
    if (settings->amplifier_bandwidth > 0) p->lag_decay = exp(-two_pi * settings->amplifier_bandwidth * step);
    set_plays(p);
    set_creep(p, step);
    set_resonance(p, step);
}

/* ---- The chain --------------------------------------------------------------------------------------------------- */

static double stack_volts(const ts_plant_settings *s, double volts)
{
    double converted = clipped(rounded(volts, s->da_step), s->da_low, s->da_high);
    return clipped(s->amplifier_gain * converted, s->stack_low, s->stack_high);
}

static void set_weights(ts_plant *p)
{
    const ts_plant_settings *s = &p->settings;
    double hours = (double)p->tick / (s->sample_rate * 3600);
    double gain = 1 + s->ageing_gain * hours, hysteresis = 1 + s->ageing_hysteresis * hours;
    if (p->tick >= s->change_tick) {
        gain *= s->change_gain;
        hysteresis *= s->change_hysteresis;
    }
    p->linear_now = gain * s->sensitivity * (1 - s->hysteresis * hysteresis);
    p->play_weight_now = gain * hysteresis * p->play_weight;
}

/* Hysteresis and asymmetry: the displacement for the stack voltage, um. Four sums, for speed. */
static double strain(ts_plant *p)
{
    const ts_plant_settings *s = &p->settings;
    double x = p->volts, sum[4] = {0, 0, 0, 0};
    int i = 0;
    for (; i + 4 <= s->plays; i += 4)
        for (int j = 0; j < 4; j++) sum[j] += p->play[i + j] = moved_play(p->play[i + j], x, p->thresholds[i + j]);
    for (; i < s->plays; i++) sum[0] += p->play[i] = moved_play(p->play[i], x, p->thresholds[i]);
    double y = p->linear_now * x + p->play_weight_now * ((sum[0] + sum[1]) + (sum[2] + sum[3]));
    return y + s->asymmetry * y * (y / s->asymmetry_stroke - 1);
}

/* First-order operators of the strain, which went from `from` to `to` in this step. */
static void advance_creep(ts_plant *p, double from, double to)
{
    double sum = 0, mean = 0.5 * (from + to);
    for (int j = 0; j < p->settings.creep_operators; j++) {
        p->creep[j] += p->creep_rate[j] * (mean - p->creep[j]);
        sum += p->creep[j];
    }
    p->crept = p->creep_weight * sum;
}

/* z'' + 2 zeta omega z' + omega^2 z = omega^2 u, where u goes from `from` to `to` as the stack voltage does: as
 * rest + part exp(-t / tau), exact unless a play or the asymmetry changes the slope within the step. Without lag u is
 * `to`. */
static void advance_stage(ts_plant *p, double from, double to)
{
    if (!(p->settings.resonance > 0)) {
        p->position = to;
        return;
    }
    double part = (from - to) / (1 - p->lag_decay), rest = to - part * p->lag_decay;
    double forced = p->ring_gain * part, forced_velocity = -p->ring_ratio * forced;
    double z = p->position - (rest + forced), v = p->velocity - forced_velocity;
    p->position = rest + p->lag_decay * forced + p->ring[0] * z + p->ring[1] * v;
    p->velocity = p->lag_decay * forced_velocity + p->ring[2] * z + p->ring[3] * v;
}

static void run_tick(ts_plant *p, double volts, const double *noise, double *measured, double *truth)
{
    const ts_plant_settings *s = &p->settings;
    double target = stack_volts(s, volts), z = 0, z_measured = 0;
    double drift = -s->drift * expm1(-((double)p->tick + 0.5) / (s->sample_rate * s->drift_time));
    int stride = s->steps_per_tick / s->samples_per_tick;

    set_weights(p);
    if (!(s->amplifier_bandwidth > 0)) p->volts = target;
    double before = strain(p); /* the weights, and without lag the voltage, jump at the start of the tick */
    for (int step = 1; step <= s->steps_per_tick; step++) {
        p->volts = target + p->lag_decay * (p->volts - target);
        double now = strain(p), crept = p->crept;
        if (s->creep > 0) advance_creep(p, before, now);
        advance_stage(p, before + crept, now + p->crept);
        before = now;
        if (step % stride == 0) {
            double sample = p->position + drift;
            z += sample;
            z_measured += clipped(rounded(sample + s->noise * *noise++, s->ad_step), s->ad_low, s->ad_high);
        }
    }
    *truth = z / s->samples_per_tick;
    *measured = z_measured / s->samples_per_tick;
    p->tick++;
}

void ts_plant_run(ts_plant *p, const double *volts, const double *noise, double *measured, double *truth, size_t ticks)
{
    for (size_t k = 0; k < ticks; k++)
        run_tick(p, volts[k], noise + k * (size_t)p->settings.samples_per_tick, &measured[k], &truth[k]);
}

/* ---- The matched plant ------------------------------------------------------------------------------------------- */

void ts_matched_init(ts_matched *m, const ts_matched_settings *settings)
{
    memset(m, 0, sizeof *m);
    m->settings = *settings;
}

/* (13) */
static double matched_displacement(ts_matched *m, double volts, double velocity)
{
    const ts_matched_settings *s = &m->settings;
    int changed = m->tick >= s->change_tick;
    double y = 0;
    for (int i = 0; i < s->plays; i++) {
        m->play[i] = moved_play(m->play[i], volts, s->thresholds[i]);
        y += (s->a[changed][i] + s->rate_scale * velocity * s->b[changed][i]) * m->play[i];
    }
    double z = s->dead_zone_weights[0] * y;
    for (int i = 1; i < s->dead_zones; i++)
        if (y > s->dead_zone_thresholds[i]) z += s->dead_zone_weights[i] * (y - s->dead_zone_thresholds[i]);
    return z;
}

void ts_matched_run(ts_matched *m, const double *volts, const double *velocity, const double *noise, double *measured,
                    double *truth, size_t ticks)
{
    for (size_t k = 0; k < ticks; k++, m->tick++) {
        truth[k] = matched_displacement(m, volts[k], velocity[k]);
        measured[k] = truth[k] + m->settings.noise * noise[k];
    }
}
