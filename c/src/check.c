/* Settings: what is refused, and which of them may change in mid-run. */
#include "controller.h"

#include <string.h>

static bool bounded(ts_real x) { return x >= -TS_LARGEST && x <= TS_LARGEST; }
static bool positive(ts_real x) { return x >= 1 / TS_LARGEST && x <= TS_LARGEST; }
static bool fraction(ts_real x) { return x >= 0 && x <= 1; }

/* Whether the poles of (b0 + b1 q^-1) / (1 + a1 q^-1 + a2 q^-2) are within the unit circle. */
static bool stable_section(const ts_real *q)
{
    return bounded(q[0]) && bounded(q[1]) && q[3] < 1 && q[3] > -1 && q[2] < 1 + q[3] && q[2] > -1 - q[3];
}

/* The same of (b0 + b1 q^-1 + b2 q^-2) / (1 + a1 q^-1 + a2 q^-2). */
static bool stable_biquad(const ts_real *q)
{
    const ts_real poles[4] = {q[0], q[1], q[3], q[4]};
    return stable_section(poles) && bounded(q[2]);
}

static bool ascends_from_zero(const ts_real *r, int n)
{
    if (r[0] != 0) return false;
    for (int i = 1; i < n; i++)
        if (!(r[i] > r[i - 1]) || !bounded(r[i])) return false;
    return true;
}

static bool partial_sums_positive(const ts_real *w, int n)
{
    ts_real sum = 0;
    for (int i = 0; i < n; i++) {
        sum += w[i];
        if (!positive(sum)) return false;
    }
    return true;
}

static ts_status check_model(const ts_settings *s)
{
    if (s->plays < 1 || s->plays > TS_MAX_PLAYS) return TS_BAD_PLAYS;
    if (!ascends_from_zero(s->thresholds, s->plays)) return TS_BAD_THRESHOLDS;
    if (s->dead_zones < 1 || s->dead_zones > TS_MAX_DEAD_ZONES) return TS_BAD_DEAD_ZONES;
    if (!ascends_from_zero(s->dead_zone_thresholds, s->dead_zones)) return TS_BAD_DEAD_ZONES;
    if (!partial_sums_positive(s->dead_zone_weights, s->dead_zones)) return TS_BAD_DEAD_ZONE_WEIGHTS;
    static const int most[TS_TERMS] = TS_MOST_WEIGHTS;
    for (int i = 0; i < TS_TERMS; i++)
        if (s->terms[i] < 0 || s->terms[i] > most[i]) return TS_BAD_TERMS;
    if (s->terms[TS_COUPLING_LAG] != s->terms[TS_COUPLING] || s->terms[TS_COUPLING_INERTIA] != s->terms[TS_COUPLING]) return TS_BAD_TERMS;
    if (ts_parameters(s) > TS_MAX_PARAMETERS) return TS_BAD_TERMS;
    for (int i = 0; i < s->terms[TS_CREEP]; i++)
        if (!(s->creep[i] > 0 && s->creep[i] <= 1)) return TS_BAD_TERMS;
    for (int i = 0; i < s->terms[TS_DUHEM]; i++)
        if (!positive(s->duhem[i])) return TS_BAD_TERMS;
    for (int i = 0; i < ts_parameters(s); i++)
        if (!bounded(s->initial_weights[i])) return TS_BAD_WEIGHTS;
    return s->rate_scale >= 0 && bounded(s->rate_scale) ? TS_OK : TS_BAD_RATE_SCALE;
}

static ts_status check_rls(const ts_settings *s)
{
    bool good = s->forgetting >= (ts_real)1e-3 && s->forgetting <= 1 && positive(s->regularization) && bounded(s->covariance_limit)
                && s->covariance_limit >= (ts_real)ts_parameters(s) / s->regularization;
    return good ? TS_OK : TS_BAD_RLS;
}

/* Variances above 0 and correlations within -1 to 1: the checks that need no factorisation. */
static bool check_prior(const ts_settings *s)
{
    ts_real variance[TS_MAX_PARAMETERS];
    const ts_real *P0 = s->prior;
    for (int i = 0, m = ts_parameters(s); i < m; i++) {
        int from = s->prior_from[i];
        if (from > i || from % TS_LANES || P0 + (i - from) >= s->prior + TS_MAX_PRIOR) return false;
        variance[i] = P0[i - from];
        bool good = variance[i] > 0 && variance[i] <= TS_LARGEST * TS_LARGEST;
        for (int j = from; j < i; j++, P0++) good = good && *P0 * *P0 <= variance[i] * variance[j] * (ts_real)1.0001;
        if (!good) return false;
        P0++;
    }
    return true;
}

static ts_status check_kalman(const ts_settings *s)
{
    const ts_kalman_settings *k = &s->kalman;
    if (ts_parameters(s) > TS_MAX_LEARNED) return TS_BAD_TERMS;
    bool good = k->filter > 0 && k->filter <= 1 && fraction(k->noise_rate) && fraction(k->ringing_rate)
                && fraction(k->prior_return) && fraction(k->change_rate) && fraction(k->usual_rate) && fraction(k->change_share)
                && k->model_error >= 0 && bounded(k->model_error) && k->change_threshold > 0 && k->refractory >= 0
                && fraction(k->change_gain) && fraction(k->change_hysteresis) && k->outlier > 0 && k->outliers >= 0 && positive(s->first_noise);
    const ts_oscillation_settings *o = &s->oscillation;
    if (o->tick != 0)
        good = good && o->tick > 0 && o->corner > 0 && o->corner <= 1 && fraction(o->fast) && fraction(o->slow)
               && fraction(o->motion_rate) && o->noise_share >= 0 && bounded(o->noise_share) && o->floor > 0 && bounded(o->floor)
               && o->large > 0 && bounded(o->large);
    const ts_guard_settings *g = &s->guard;
    good = good && g->window >= 0 && g->recall >= 0 && g->recall <= TS_LONGEST_RECALL && fraction(g->range_rate) && g->burst >= 0 && bounded(g->burst) && (g->window == 0 || positive(g->floor));
    good = good && (s->resonance >= (ts_real)1e-6 || !(s->resonance < 0 || s->resonance > 0)) && s->resonance <= 1 && (o->tick > 0 || !(s->resonance > 0));
    return good && check_prior(s) ? TS_OK : TS_BAD_KALMAN;
}

static ts_status check_dynamics(const ts_dynamics *d)
{
    bool good = d->sections >= 0 && d->sections <= TS_SECTIONS && d->others >= 0 && d->others <= TS_SECTIONS && d->modes >= 0 && d->modes <= TS_SECTIONS && d->dead >= 0
                && d->dead < TS_HISTORY / 2 && d->amplifier >= 0 && d->amplifier < 1 && bounded(d->lead[0]) && bounded(d->lead[1])
                && bounded(d->sensor[0]) && bounded(d->sensor[1]);
    if (!good || (d->known && !(d->first > 0 && d->first < 1))) return TS_BAD_DYNAMICS;
    for (int i = 0; i < d->sections; i++) good = good && stable_section(d->section[i]);
    for (int i = 0; i < d->others; i++) good = good && stable_section(d->rest[i]);
    for (int i = 0; i < d->modes; i++) good = good && stable_biquad(d->mode[i]);
    for (int i = 0; i < 3; i++) good = good && bounded(d->direct[i]) && bounded(d->notch[i]) && bounded(d->quiet[i]);
    for (int i = 0; i < TS_TAPS; i++) good = good && bounded(d->tap[i]);
    return good ? TS_OK : TS_BAD_DYNAMICS;
}

static ts_status check_sensor(const ts_settings *settings)
{
    const ts_sensor *s = &settings->sensor;
    bool passes = s->share > 0 || s->lag > 0, none = s->ticks == 0 && !passes;
    if (passes && ts_parameters(settings) > TS_MAX_SENSED) return TS_BAD_SENSOR;
    bool good = s->ticks >= 0 && s->ticks < TS_HISTORY / 2 && fraction(s->share) && s->lag >= 0 && bounded(s->lag) && s->pole >= 0 && s->pole < 1
                && fraction(s->now) && fraction(s->before) && bounded(s->slow[0]) && bounded(s->slow[1]);
    return good && (none || !settings->dynamics.known) ? TS_OK : TS_BAD_SENSOR;
}

static ts_status check_feedback(const ts_feedback *f)
{
    bool good = f->filters >= 0 && f->filters <= TS_FEEDBACKS && f->most >= 0 && bounded(f->most);
    for (int i = 0; good && i < f->filters; i++) good = stable_biquad(f->filter[i]);
    return good ? TS_OK : TS_BAD_FEEDBACK;
}

static ts_status check_hum(const ts_hum *h)
{
    bool good = h->lines >= 0 && h->lines <= TS_LINES - TS_HEARD;
    for (int i = 0; good && i < h->lines; i++) good = fraction(size_of(h->line[i][0])) && fraction(size_of(h->line[i][1])) && positive(h->line[i][2]);
    return good ? TS_OK : TS_BAD_HUM;
}

ts_status ts_check(const ts_settings *s)
{
    ts_status status = check_model(s);
    if (status != TS_OK) return status;
    ts_status law = s->law == TS_LAW_RLS ? check_rls(s) : check_kalman(s);
    if (law != TS_OK) return law;
    ts_status dynamics = check_dynamics(&s->dynamics);
    if (dynamics != TS_OK) return dynamics;
    if (s->dynamics.known && s->law != TS_LAW_KALMAN) return TS_BAD_DYNAMICS;
    ts_status sensor = check_sensor(s);
    if (sensor != TS_OK) return sensor;
    ts_status feedback = check_feedback(&s->feedback);
    if (feedback != TS_OK) return feedback;
    ts_status hum = check_hum(&s->hum);
    if (hum != TS_OK) return hum;
    if (s->hum.lines > 0 && (s->law != TS_LAW_KALMAN || !(s->oscillation.tick > 0))) return TS_BAD_HUM;
    if (!positive(s->slope_min) || !(s->slope_min < s->slope_max) || !positive(s->slope_max)) return TS_BAD_SLOPE;
    if (!(s->voltage_min < s->voltage_max) || !bounded(s->voltage_min) || !bounded(s->voltage_max) || !(s->slew > 0))
        return TS_BAD_VOLTAGE;
    bool good = s->velocity_limit >= 0 && bounded(s->velocity_limit) && positive(s->stroke) && positive(s->measurement_limit) && s->smoothing >= 0 && s->smoothing < 1
                && fraction(s->trim) && (positive(s->oscillation.tick) || !(s->oscillation.tick < 0 || s->oscillation.tick > 0));
    return good ? TS_OK : TS_BAD_LIMIT;
}

static bool equal(const ts_real *a, const ts_real *b, int n)
{
    bool same = true;
    for (int i = 0; i < n; i++) same = same && !(a[i] < b[i] || a[i] > b[i]);
    return same;
}

static bool same_dynamics(const ts_dynamics *a, const ts_dynamics *b)
{
    bool same = a->known == b->known && equal(&a->first, &b->first, 1) && a->sections == b->sections && a->dead == b->dead && a->others == b->others
                && a->modes == b->modes;
    return same && equal(&a->mode[0][0], &b->mode[0][0], 5 * TS_SECTIONS) && equal(&a->section[0][0], &b->section[0][0], 4 * TS_SECTIONS) && equal(a->direct, b->direct, 3)
           && equal(a->notch, b->notch, 3) && equal(a->quiet, b->quiet, 3) && equal(a->tap, b->tap, TS_TAPS) && equal(&a->rest[0][0], &b->rest[0][0], 4 * TS_SECTIONS)
           && equal(&a->amplifier, &b->amplifier, 1) && equal(a->lead, b->lead, 2) && equal(a->sensor, b->sensor, 2);
}

static bool same_prior(const ts_settings *a, const ts_settings *b)
{
    int m = ts_parameters(a);
    return memcmp(a->prior_from, b->prior_from, (size_t)m) == 0 && equal(a->prior, b->prior, ts_prior_entries(a, m));
}

/* What a law has learned belongs to its terms, thresholds, times and prior. */
bool ts_same_model(const ts_settings *a, const ts_settings *b)
{
    bool same = a->law == b->law && a->plays == b->plays && a->dead_zones == b->dead_zones;
    for (int i = 0; i < TS_TERMS; i++) same = same && a->terms[i] == b->terms[i];
    for (int i = 0; same && i < a->plays; i++) same = a->rate_dependent[i] == b->rate_dependent[i];
    int m = same ? ts_parameters(a) : 0;
    return same && equal(a->thresholds, b->thresholds, a->plays) && equal(a->creep, b->creep, a->terms[TS_CREEP]) && equal(a->duhem, b->duhem, a->terms[TS_DUHEM])
           && equal(a->dead_zone_thresholds, b->dead_zone_thresholds, a->dead_zones) && equal(&a->stroke, &b->stroke, 1)
           && equal(a->initial_weights, b->initial_weights, m) && equal(&a->regularization, &b->regularization, 1)
           && equal(&a->oscillation.tick, &b->oscillation.tick, 1) && same_dynamics(&a->dynamics, &b->dynamics)
           && a->sensor.ticks == b->sensor.ticks && equal(&a->sensor.share, &b->sensor.share, 1) && equal(&a->sensor.lag, &b->sensor.lag, 1)
           && (a->law != TS_LAW_KALMAN || same_prior(a, b));
}

bool ts_same_stage(const ts_settings *a, const ts_settings *b)
{
    return equal(&a->kalman.filter, &b->kalman.filter, 1) && equal(&a->smoothing, &b->smoothing, 1)
           && equal(&a->resonance, &b->resonance, 1);
}
