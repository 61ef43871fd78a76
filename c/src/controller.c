#include "truestroke.h"

#include <math.h>
#include <string.h>

/* ---- Settings ---------------------------------------------------------------------------------------------------- */

static bool ascends_from_zero(const ts_real *r, int n)
{
    if (r[0] != 0) return false;
    for (int i = 1; i < n; i++)
        if (!(r[i] > r[i - 1]) || !isfinite(r[i])) return false;
    return true;
}

static bool partial_sums_positive(const ts_real *w, int n)
{
    ts_real sum = 0;
    for (int i = 0; i < n; i++) {
        sum += w[i];
        if (!(sum > 0) || !isfinite(sum)) return false;
    }
    return true;
}

static ts_status check(const ts_settings *s)
{
    if (s->plays < 1 || s->plays > TS_MAX_PLAYS) return TS_BAD_PLAYS;
    if (!ascends_from_zero(s->thresholds, s->plays)) return TS_BAD_THRESHOLDS;
    if (s->dead_zones < 1 || s->dead_zones > TS_MAX_DEAD_ZONES) return TS_BAD_DEAD_ZONES;
    if (!ascends_from_zero(s->dead_zone_thresholds, s->dead_zones)) return TS_BAD_DEAD_ZONES;
    if (!partial_sums_positive(s->dead_zone_weights, s->dead_zones)) return TS_BAD_DEAD_ZONE_WEIGHTS;
    for (int i = 0; i < 2 * s->plays; i++)
        if (!isfinite(s->initial_weights[i])) return TS_BAD_WEIGHTS;
    if (!(s->rate_scale >= 0) || !isfinite(s->rate_scale)) return TS_BAD_RATE_SCALE;
    if (!(s->forgetting > 0 && s->forgetting <= 1)) return TS_BAD_FORGETTING;
    if (!(s->regularization > 0) || !isfinite(s->regularization)) return TS_BAD_REGULARIZATION;
    if (!(s->covariance_limit >= (ts_real)(2 * s->plays) / s->regularization)) return TS_BAD_COVARIANCE_LIMIT;
    if (!(s->slope_min > 0) || !isfinite(s->slope_min)) return TS_BAD_SLOPE;
    if (!(s->voltage_min < s->voltage_max) || !isfinite(s->voltage_min) || !isfinite(s->voltage_max))
        return TS_BAD_VOLTAGE;
    return TS_OK;
}

/* ---- The arrows of Fig. 5 ------------------------------------------------------------------------------------------ */

/* (7) and its partial sums at the rate zdot_d, each at least slope_min; tells whether one had to be lifted. */
static bool rate_dependent_slopes(ts_controller *c, ts_real zdot_d)
{
    const ts_settings *s = &c->settings;
    bool lifted = false;
    ts_real sum = 0;
    for (int i = 0; i < s->plays; i++) {
        sum += c->w[2 * i] + s->rate_scale * zdot_d * c->w[2 * i + 1];
        c->slopes[i] = sum >= s->slope_min ? sum : s->slope_min;
        lifted |= !(sum >= s->slope_min);
    }
    return lifted;
}

static ts_real within_limits(ts_controller *c, ts_real x)
{
    const ts_settings *s = &c->settings;
    c->flags.saturated = !(x >= s->voltage_min && x <= s->voltage_max);
    if (!(x >= s->voltage_min)) return s->voltage_min; /* NaN, too, leaves as a voltage within limits */
    return x <= s->voltage_max ? x : s->voltage_max;
}

/* The play states of the tick `tick`, from those of the last tick that was measured. */
static void lagged_plays_to(ts_controller *c, uint64_t tick)
{
    for (; c->lagged_tick <= tick; c->lagged_tick++)
        ts_play_bank(c->x[c->lagged_tick % TS_HISTORY], c->settings.thresholds, c->lagged_play, c->settings.plays);
}

/* (20) */
static void regressor(ts_controller *c, ts_real zdot_d)
{
    for (int i = 0; i < c->settings.plays; i++) {
        c->u[2 * i] = c->lagged_play[i];
        c->u[2 * i + 1] = c->settings.rate_scale * zdot_d * c->lagged_play[i];
    }
}

static ts_real dot(const ts_real *a, const ts_real *b, int n)
{
    ts_real sum = 0;
    for (int i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

/* ---- Public -------------------------------------------------------------------------------------------------------- */

ts_status ts_controller_init(ts_controller *c, const ts_settings *settings)
{
    ts_status status = check(settings);
    if (status != TS_OK) return status;
    c->settings = *settings;
    ts_controller_reset(c);
    return TS_OK;
}

void ts_controller_reset(ts_controller *c)
{
    ts_settings settings = c->settings;
    memset(c, 0, sizeof *c);
    c->settings = settings;
    int m = 2 * settings.plays;
    for (int i = 0; i < m; i++) {
        c->w[i] = settings.initial_weights[i];
        c->S[i * m + i] = 1 / (ts_real)sqrt(settings.regularization);
    }
    (void)rate_dependent_slopes(c, 0);
}

ts_status ts_controller_command(ts_controller *c, ts_real z_d, ts_real zdot_d, ts_real *volts)
{
    const ts_settings *s = &c->settings;
    if (!isfinite(z_d) || !isfinite(zdot_d)) return TS_NOT_FINITE;
    uint64_t tick = c->counters.commands++;
    if (tick >= TS_HISTORY) lagged_plays_to(c, tick - TS_HISTORY); /* before its slot is taken */

    c->y_d = ts_dead_zones(z_d, s->dead_zone_thresholds, s->dead_zone_weights, s->dead_zones);
    c->flags.projected = rate_dependent_slopes(c, zdot_d);
    ts_real x = ts_play_inverse(c->y_d, c->slopes, s->thresholds, c->play, s->plays);
    x = within_limits(c, x);
    ts_play_bank(x, s->thresholds, c->play, s->plays);

    c->x[tick % TS_HISTORY] = x;
    c->zdot_d[tick % TS_HISTORY] = zdot_d;
    c->counters.projected += c->flags.projected;
    c->counters.saturated += c->flags.saturated;
    *volts = x;
    return TS_OK;
}

ts_status ts_controller_adapt(ts_controller *c, ts_real z, int ago)
{
    const ts_settings *s = &c->settings;
    uint64_t commands = c->counters.commands;
    bool in_time = ago >= 0 && ago < TS_HISTORY && (uint64_t)ago < commands
                   && commands - (uint64_t)ago > c->lagged_tick;
    c->flags.rejected = !in_time || !isfinite(z);
    if (c->flags.rejected) {
        c->counters.rejected++;
        return TS_REJECTED;
    }
    uint64_t tick = commands - 1 - (uint64_t)ago;
    lagged_plays_to(c, tick);
    regressor(c, c->zdot_d[tick % TS_HISTORY]);
    ts_real y_a = ts_dead_zones(z, s->dead_zone_thresholds, s->dead_zone_weights, s->dead_zones);
    c->innovation = y_a - dot(c->w, c->u, 2 * s->plays); /* (15) */
    if (c->hold) return TS_OK;
    if (!ts_rls_update(c->w, c->S, c->f, c->u, c->innovation, s->forgetting, s->covariance_limit, 2 * s->plays)) {
        c->flags.rejected = true;
        c->counters.rejected++;
        return TS_REJECTED;
    }
    c->counters.adaptations++;
    return TS_OK;
}

void ts_controller_hold(ts_controller *c, bool hold)
{
    c->hold = hold;
    c->flags.held = hold;
}
