#include "stage.h"

#include <math.h>
#include <string.h>

static const double two_pi = 6.283185307179586476925;

static double clipped(double x, double low, double high)
{
    return x < low ? low : x > high ? high : x;
}

/* ---- Hysteresis: operators of x --------------------------------------------------------------------------------- */

/* Plays whose rising and falling envelopes differ: y = max(x - a x^2 - r, min(x + a x^2 + r, y)). Their mean. Four
 * sums, for speed. */
static double moved_plays(const ts_stage *p, ts_stage_memory *m, double x)
{
    const ts_stage_settings *s = &p->settings;
    double rising = x - s->envelope * x * x, falling = x + s->envelope * x * x, sum[4] = {0, 0, 0, 0};
    for (int i = 0; i < s->plays; i++) {
        double low = rising - p->threshold[i], high = falling + p->threshold[i];
        double inner = m->play[i] < high ? m->play[i] : high;
        sum[i % 4] += m->play[i] = inner > low ? inner : low;
    }
    return ((sum[0] + sum[1]) + (sum[2] + sum[3])) / s->plays;
}

/* Integral of the density exp(-(a - b) / rho) (1 + k1 s + k2 s^2), s = (a + b) / 2 - 1/2, over the relays that switch
 * up at a and down at b, low <= b <= a <= high. Along lines of equal d = a - b the polynomial gives L (1 + k1 m +
 * k2 m^2) + k2 L^3 / 12, L = D - d; then I_n, the integral of L^n exp(-d / rho), is rho D^n - n rho I_(n-1). */
static double everett(const ts_stage_settings *s, double high, double low)
{
    double D = high - low, middle = 0.5 * (high + low) - 0.5, rho = s->preisach_scale;
    double i0 = -rho * expm1(-D / rho), i1 = rho * (D - i0), i2 = rho * (D * D - 2 * i1);
    double i3 = rho * (D * D * D - 3 * i2);
    return (1 + s->preisach_tilt * middle + s->preisach_curvature * middle * middle) * i1 +
           s->preisach_curvature / 12 * i3;
}

/* A Preisach operator by its Everett function: it remembers the turning points that no larger swing has wiped out. The
 * lowest is turn[0], so the voltage rises where their number is odd. A full memory forgets its smallest loop. */
static double preisach(const ts_stage *p, ts_stage_memory *m, double x)
{
    const ts_stage_settings *s = &p->settings;
    int rising = m->turns % 2, last = m->turns - 1;
    if (rising ? x < m->x : x > m->x) {
        if (m->turns == TS_STAGE_MAX_TURNS) {
            m->turns -= 2;
        } else {
            double swing = rising ? everett(s, m->x, m->turn[last]) : -everett(s, m->turn[last], m->x);
            m->at_turn[m->turns] = m->at_turn[last] + swing;
            m->turn[m->turns++] = m->x;
            rising = !rising;
        }
    }
    while (m->turns > 2 && (rising ? x >= m->turn[m->turns - 2] : x <= m->turn[m->turns - 2])) m->turns -= 2;
    if (m->turns == 2 && x <= m->turn[0]) m->turns = rising = 1;
    last = m->turns - 1;
    m->x = x;
    return m->at_turn[last] + (rising ? everett(s, x, m->turn[last]) : -everett(s, m->turn[last], x));
}

/* dq/dx where x rises (way = 1) or falls (-1). */
static double bouc_wen_slope(const ts_stage_settings *s, double q, double way)
{
    double n = s->bouc_wen_exponent, size = n == 1 ? fabs(q) : pow(fabs(q), n);
    return 1 - s->bouc_wen_beta * way * copysign(size, q) - s->bouc_wen_gamma * size;
}

/* q' = x' - beta |x'| q |q|^(n-1) - gamma x' |q|^n by Runge and Kutta, in steps of at most 0.01 of x. */
static double bouc_wen(const ts_stage *p, ts_stage_memory *m, double x)
{
    const ts_stage_settings *s = &p->settings;
    double way = x < m->x ? -1 : 1;
    int parts = (int)ceil(fabs(x - m->x) / 0.01);
    for (int i = 0; i < parts; i++) {
        double h = (x - m->x) / parts, k1 = bouc_wen_slope(s, m->q, way);
        double k2 = bouc_wen_slope(s, m->q + 0.5 * h * k1, way), k3 = bouc_wen_slope(s, m->q + 0.5 * h * k2, way);
        double k4 = bouc_wen_slope(s, m->q + h * k3, way);
        m->q += h / 6 * (k1 + 2 * (k2 + k3) + k4);
    }
    m->x = x;
    return m->q;
}

static double operator_of(const ts_stage *p, ts_stage_memory *m, double x)
{
    if (p->settings.hysteresis == TS_STAGE_PREISACH) return preisach(p, m, x);
    if (p->settings.hysteresis == TS_STAGE_BOUC_WEN) return bouc_wen(p, m, x);
    return moved_plays(p, m, x);
}

static ts_stage_memory rest_memory(const ts_stage_settings *s)
{
    ts_stage_memory m;
    memset(&m, 0, sizeof m);
    m.turn[0] = s->volts_low / s->volts_high;
    m.turns = 1;
    return m;
}

/* The weights of x and of the operator P that make the loop over x = 0..1 as high as the stroke and as wide as
 * loop_width: measured on its fourth cycle, at 256 points a branch. */
static void set_hysteresis(ts_stage *p)
{
    const ts_stage_settings *s = &p->settings;
    enum { points = 256, cycles = 4 };
    for (int i = 0; i < s->plays; i++)
        p->threshold[i] = s->threshold_max * pow((i + 0.5) / s->plays, s->threshold_exponent);
    ts_stage_memory m = rest_memory(s);
    p->offset = operator_of(p, &m, 0);
    double up[points + 1] = {p->offset}, down[points + 1];
    for (int cycle = 0; cycle < cycles; cycle++) {
        if (cycle) up[0] = down[0];
        for (int i = 1; i <= points; i++) up[i] = operator_of(p, &m, (double)i / points);
        down[points] = up[points];
        for (int i = points - 1; i >= 0; i--) down[i] = operator_of(p, &m, (double)i / points);
    }
    double width = 0, height = up[points] - down[0];
    for (int i = 1; i < points; i++)
        if (fabs(down[i] - up[i]) > fabs(width)) width = down[i] - up[i];
    int flat = width == 0 && s->loop_width > 0; /* the plays are too wide to move: no weight gives the loop its width */
    double weight = s->loop_width > 0 && !flat ? s->loop_width / width : 0, linear = 1 - weight * height;
    p->least_slope = flat ? 0 : HUGE_VAL;
    for (int i = 0; i < points; i++) {
        p->least_slope = fmin(p->least_slope, linear + weight * points * (up[i + 1] - up[i]));
        p->least_slope = fmin(p->least_slope, linear + weight * points * (down[i + 1] - down[i]));
    }
    p->linear = s->stroke * linear;
    p->hysteretic = s->stroke * weight;
    p->offset *= p->hysteretic;
}

/* ---- Setting up -------------------------------------------------------------------------------------------------- */

static void set_piece(ts_stage_piece *piece, const ts_stage_settings *s, double length)
{
    memset(piece, 0, sizeof *piece);
    if (s->amplifier_bandwidth > 0) piece->lag = exp(-two_pi * s->amplifier_bandwidth * length);
    double decades = log10(s->creep_longest / s->creep_shortest);
    for (int j = 0; j < s->creep_operators; j++) {
        double tau = s->creep_shortest * pow(10, decades * (j + 0.5) / s->creep_operators);
        piece->creep_rate[j] = -expm1(-length / tau);
    }
}

/* z'' + 2 zeta omega z' + omega^2 z = 0 over a piece, of (z, z'). */
static void set_ring(ts_stage_piece *piece, const ts_stage *p, double length)
{
    for (int i = 0; i < p->settings.modes; i++) {
        double zeta = p->settings.dampings[i], omega = p->omega[i], root = sqrt(1 - zeta * zeta);
        double angle = omega * length, decay = exp(-zeta * angle), *ring = piece->ring[i];
        double cosine = decay * cos(root * angle), sine = decay * sin(root * angle) / root;
        ring[0] = cosine + zeta * sine;
        ring[1] = sine / omega;
        ring[2] = -omega * sine;
        ring[3] = cosine - zeta * sine;
    }
}

/* The resonances of this tick. */
static void set_modes(ts_stage *p)
{
    const ts_stage_settings *s = &p->settings;
    double factor = 1 + s->resonance_drift * (double)p->tick / (s->sample_rate * 60);
    if (p->tick >= s->resonance_change_tick) factor *= s->resonance_change;
    if (factor == p->factor) return;
    double step = 1 / (s->sample_rate * s->steps_per_tick), rate = two_pi * s->amplifier_bandwidth;
    p->factor = factor;
    for (int i = 0; i < s->modes; i++) {
        p->omega[i] = two_pi * s->resonances[i] * factor;
        double ratio = rate / p->omega[i];
        p->forced[i] = rate > 0 ? 1 / (1 - 2 * s->dampings[i] * ratio + ratio * ratio) : 0;
    }
    set_ring(&p->step, p, step);
    set_ring(&p->before, p, step * p->late_part);
    set_ring(&p->after, p, step * (1 - p->late_part));
}

/* Whole units of a length, and what remains; a remainder that rounding alone made is none. */
static int whole_of(double length, double *rest)
{
    int whole = (int)floor(length + 1e-9);
    *rest = length - whole > 1e-9 ? length - whole : 0;
    return whole;
}

/* The lag of the sensor for a displacement that is a straight line over a step; then its delay, by Lagrange's
 * polynomial through four displacements. */
static void set_sensor(ts_stage *p, double step)
{
    const ts_stage_settings *s = &p->settings;
    p->sensor[2] = 1;
    if (s->sensor_bandwidth > 0) {
        double ratio = two_pi * s->sensor_bandwidth * step, decay = exp(-ratio), mean = -expm1(-ratio) / ratio;
        p->sensor[0] = decay;
        p->sensor[1] = mean - decay;
        p->sensor[2] = 1 - mean;
    }
    double rest, delay = s->sensor_delay / step;
    int whole = whole_of(delay, &rest);
    p->sensor_base = whole > 0 && rest > 0 ? whole - 1 : whole;
    double at = whole - p->sensor_base + rest;
    for (int i = 0; i < 4; i++) {
        p->sensor_weight[i] = 1;
        for (int j = 0; j < 4; j++)
            if (j != i) p->sensor_weight[i] *= (at - j) / (i - j);
    }
}

void ts_stage_init(ts_stage *p, const ts_stage_settings *settings)
{
    memset(p, 0, sizeof *p);
    p->settings = *settings;
    double rest, step = 1 / (settings->sample_rate * settings->steps_per_tick);
    p->late_ticks = whole_of(settings->dead_time * settings->sample_rate, &rest);
    p->late_steps = whole_of(rest * settings->steps_per_tick, &p->late_part);
    set_piece(&p->step, settings, step);
    set_piece(&p->before, settings, step * p->late_part);
    set_piece(&p->after, settings, step * (1 - p->late_part));
    double decades = log10(settings->creep_longest / settings->creep_shortest);
    p->creep_weight = settings->creep * decades / settings->creep_operators;
    set_hysteresis(p);
    set_sensor(p, step);
    p->memory = rest_memory(settings);
}

/* ---- The chain --------------------------------------------------------------------------------------------------- */

static double strain(ts_stage *p)
{
    double x = p->volts / p->settings.volts_high;
    if (!(p->settings.loop_width > 0)) return p->linear * x;
    return p->linear * x + p->hysteretic * operator_of(p, &p->memory, x) - p->offset;
}

static void advance_creep(ts_stage *p, const ts_stage_piece *piece, double from, double to)
{
    double sum = 0, mean = 0.5 * (from + to);
    for (int j = 0; j < p->settings.creep_operators; j++) {
        p->creep[j] += piece->creep_rate[j] * (mean - p->creep[j]);
        sum += p->creep[j];
    }
    p->crept = p->creep_weight * sum;
}

/* Each mode for u that goes from `from` to `to` as the voltage does: as rest + part exp(-t / tau); without lag u is
 * their mean. */
static void advance_modes(ts_stage *p, const ts_stage_piece *piece, double from, double to)
{
    double rate = two_pi * p->settings.amplifier_bandwidth;
    double part = rate > 0 ? (from - to) / (1 - piece->lag) : 0;
    double rest = rate > 0 ? to - part * piece->lag : 0.5 * (from + to);
    for (int i = 0; i < p->settings.modes; i++) {
        double forced = p->forced[i] * part, z = p->position[i] - (rest + forced), v = p->velocity[i] + rate * forced;
        const double *ring = piece->ring[i];
        p->position[i] = rest + piece->lag * forced + ring[0] * z + ring[1] * v;
        p->velocity[i] = -piece->lag * rate * forced + ring[2] * z + ring[3] * v;
    }
}

/* A piece of a step, in which the amplifier is at `target` and the force on the stage goes from `pushed` to `pushes`,
 * um. */
static void advance(ts_stage *p, const ts_stage_piece *piece, double target, double pushed, double pushes)
{
    if (!(p->settings.amplifier_bandwidth > 0) && p->volts != target) { /* the voltage jumps as the piece begins */
        p->volts = target;
        p->strain = strain(p);
    }
    double from = p->strain, crept = p->crept;
    p->volts = target + piece->lag * (p->volts - target);
    p->strain = strain(p);
    if (p->settings.creep > 0) advance_creep(p, piece, from, p->strain);
    advance_modes(p, piece, from + crept + pushed, p->strain + p->crept + pushes);
}

double ts_stage_load(const ts_stage *p, double seconds)
{
    const ts_stage_settings *s = &p->settings;
    if (s->load == 0 || p->tick < s->load_tick) return 0;
    if (!(s->load_frequency > 0)) return s->load;
    return s->load * sin(two_pi * s->load_frequency * ((double)(p->tick - s->load_tick) / s->sample_rate + seconds));
}

/* What the sensor makes of the displacement `z` at the end of a step. */
static double sensed(ts_stage *p, double z)
{
    int before = p->newest;
    p->newest = (p->newest + 1) % TS_STAGE_PAST;
    p->past[p->newest] = p->sensor[0] * p->past[before] + p->sensor[1] * p->displaced + p->sensor[2] * z;
    p->displaced = z;
    double sum = 0;
    for (int i = 0; i < 4; i++)
        sum += p->sensor_weight[i] * p->past[(p->newest - p->sensor_base - i + TS_STAGE_PAST) % TS_STAGE_PAST];
    return sum;
}

void ts_stage_begin(ts_stage *p, ts_stage_tick *t, double volts, double pushed, const double *noise)
{
    const ts_stage_settings *s = &p->settings;
    const uint64_t kept = TS_STAGE_MAX_DELAY + 2, now = p->tick + kept - (uint64_t)p->late_ticks;
    p->held[p->tick % kept] = clipped(volts, s->volts_low, s->volts_high);
    t->old = p->held[(now - 1) % kept];
    t->target = p->held[now % kept];
    t->pushed = pushed;
    t->z_sum = t->measured_sum = 0;
    t->noise = noise;
    set_modes(p);
}

void ts_stage_step(ts_stage *p, ts_stage_tick *t, int i, double pushes, double behind)
{
    const ts_stage_settings *s = &p->settings;
    int stride = s->steps_per_tick / s->samples_per_tick;
    if (i == p->late_steps && p->late_part > 0) {
        double between = t->pushed + p->late_part * (pushes - t->pushed);
        advance(p, &p->before, t->old, t->pushed, between);
        advance(p, &p->after, t->target, between, pushes);
    } else {
        advance(p, &p->step, i < p->late_steps ? t->old : t->target, t->pushed, pushes);
    }
    t->pushed = pushes;
    double z = behind;
    for (int j = 0; j < s->modes; j++) z += s->shares[j] * p->position[j];
    if (s->hum != 0) {
        double seconds = (i + 1) * (1 / (s->sample_rate * s->steps_per_tick));
        z += s->hum * sin(two_pi * s->hum_frequency * ((double)p->tick / s->sample_rate + seconds));
    }
    double seen = sensed(p, z);
    if ((i + 1) % stride == stride / 2) {
        t->z_sum += z;
        t->measured_sum += seen + s->noise * *t->noise++;
    }
}

void ts_stage_end(ts_stage *p, const ts_stage_tick *t, double *measured, double *truth)
{
    *truth = t->z_sum / p->settings.samples_per_tick;
    *measured = t->measured_sum / p->settings.samples_per_tick;
    p->tick++;
}

static void run_tick(ts_stage *p, double volts, double load, const double *noise, double *measured, double *truth)
{
    const ts_stage_settings *s = &p->settings;
    double step = 1 / (s->sample_rate * s->steps_per_tick);
    ts_stage_tick t;
    ts_stage_begin(p, &t, volts, s->load_on_stage ? load + ts_stage_load(p, 0) : 0, noise);
    for (int i = 0; i < s->steps_per_tick; i++) {
        double loaded = load + ts_stage_load(p, (i + 1) * step);
        ts_stage_step(p, &t, i, s->load_on_stage ? loaded : 0, s->load_on_stage ? 0 : loaded);
    }
    ts_stage_end(p, &t, measured, truth);
}

void ts_stage_run(ts_stage *p, const double *volts, const double *load, const double *noise, double *measured,
                  double *truth, size_t ticks)
{
    for (size_t k = 0; k < ticks; k++)
        run_tick(p, volts[k], load ? load[k] : 0, noise + k * (size_t)p->settings.samples_per_tick, &measured[k],
                 &truth[k]);
}
