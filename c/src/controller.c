/* The controller as a whole: its start, its settings, and what is forgotten. */
#include "controller.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#define AT_FIRST 60 /* 1/s: rate of sudden changes at the start, so that the feedback begins a tenth of a second later */

ts_status ts_controller_init(ts_controller *c, const ts_settings *settings)
{
    ts_status status = ts_check(settings);
    if (status != TS_OK) return status;
    c->settings = settings;
    c->parameters = ts_parameters(settings);
    c->of_plays = ts_column(settings, TS_CREEP);
    ts_controller_reset(c);
    return TS_OK;
}

static void start_law(ts_controller *c)
{
    const ts_settings *s = c->settings;
    if (s->law == TS_LAW_RLS) {
        ts_rls_init(&c->law.rls, s->regularization, c->parameters);
        return;
    }
    ts_kalman_init(&c->law.kalman, prior_of(s), s->first_noise, c->parameters);
    for (int i = 0, k = 0; i < s->plays && k < TS_MAX_LEARNED; i++) { /* gcc does not know that k is below */
        c->law.kalman.part[k] = i ? 2 : 1;
        k += s->rate_dependent[i] ? 2 : 1;
    }
}

void ts_controller_reset(ts_controller *c)
{
    size_t after = offsetof(ts_controller, w);
    memset((char *)c + after, 0, sizeof *c - after);
    memcpy(c->w, c->settings->initial_weights, sizeof(ts_real) * (size_t)c->parameters);
    start_law(c);
    ts_forget_stage(c);
    c->feedback.alarms = AT_FIRST; /* nothing is learned yet */
    c->feedback.paused = true;
    ts_hum_begin(&c->hum);
    ts_keep_start(c);
    (void)ts_rate_dependent_slopes(c, 0);
}

ts_real ts_reach(const ts_settings *s, ts_real volts)
{
    ts_real share = (volts < 0 ? -volts : volts) / (s->voltage_max - s->voltage_min);
    ts_real reach = 3 * s->stroke * (1 + share);
    return reach < s->measurement_limit ? reach : s->measurement_limit;
}

ts_status ts_controller_start(ts_controller *c, ts_real volts, ts_real z)
{
    const ts_settings *s = c->settings;
    if (!isfinite(volts) || !isfinite(z)) return TS_NOT_FINITE;
    if (volts < s->voltage_min || volts > s->voltage_max) return TS_BAD_VOLTAGE;
    if (!(z >= -ts_reach(s, volts) && z <= ts_reach(s, volts))) return TS_BEYOND_REACH;
    ts_controller_reset(c);
    ts_play_bank(volts, s->thresholds, c->now.play, s->plays);
    for (int i = 0; i < s->terms[TS_CREEP]; i++) c->now.creep[i] = volts;
    for (int i = 0; i < s->terms[TS_DUHEM]; i++) c->now.duhem[i] = volts;
    c->lagged = c->now;
    const ts_motion still = {.z_d = z};
    ts_real missing = ts_wanted_of_plays(c, &still, ts_of_known_terms(c, &still)) - ts_sum_of_plays(c);
    if (s->terms[TS_OFFSET] > 0) c->w[ts_column(s, TS_OFFSET)] += missing; /* a constant until there are data */
    else c->bumpless = -missing;
    ts_keep_start(c);
    return TS_OK;
}

ts_status ts_controller_change(ts_controller *c, const ts_settings *next)
{
    const ts_settings *s = c->settings;
    ts_status status = ts_check(next);
    if (status != TS_OK) return status;
    if (!ts_same_model(s, next)) return TS_BAD_TERMS;
    bool as_it_was = ts_same_stage(s, next), other_lines = s->hum.lines != next->hum.lines;
    c->settings = next;
    if (!as_it_was) ts_forget_stage(c);
    if (other_lines) ts_hum_anew(&c->hum);
    if (!(next->trim > 0)) c->integral = 0; /* its share goes into the bumpless transfer */
    ts_keep_command(c);
    return TS_OK;
}

void ts_controller_hold(ts_controller *c, bool hold)
{
    c->hold = hold;
    c->flags.held = hold;
}

void ts_controller_complete(ts_controller *c)
{
    if (c->settings->law == TS_LAW_KALMAN) ts_kalman_complete(&c->law.kalman, prior_of(c->settings), c->parameters);
}
