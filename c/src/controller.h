/* The parts of the controller: what each of its files offers the others, in the order of a tick. */
#ifndef TRUESTROKE_CONTROLLER_H
#define TRUESTROKE_CONTROLLER_H

#include "lanes.h"

#define PAUSE 100                     /* 1/s: rate of sudden changes from which on the feedback pauses */
#define FOUND_DAMPING ((ts_real)0.02) /* of a stage that was found */
#define DOUBT ((ts_real)0.01)         /* of the motion's range: an error that the dynamics of the settings should not leave, */
#define LASTS 8                       /* and windows after which they are doubted */

/* The stage: that of the settings, or the one that was found. */
static inline const ts_dynamics *dynamics_of(const ts_controller *c)
{
    return c->found.known ? &c->found : &c->settings->dynamics;
}

/* Share of the last tick's voltage that the lag of the amplifier keeps: as given, or as it was found with the stage; 0: it has none. */
static inline ts_real amplifier_of(const ts_controller *c)
{
    return c->found.known && !c->settings->dynamics.known ? c->found.amplifier : c->settings->dynamics.amplifier;
}

/* Whether the dynamics of the settings are in use. */
static inline bool is_given(const ts_controller *c)
{
    return c->settings->dynamics.known && !c->found.known;
}

/* Whether earlier weights are held, since learning made the error larger. */
static inline bool is_restored(const ts_controller *c)
{
    return c->guard.held > 0 || (c->found.known && c->stage.before.growth.held > 0);
}

/* Whether the inertia of the stage is learned from the measured acceleration. */
static inline bool measures_inertia(const ts_controller *c)
{
    const ts_settings *s = c->settings;
    return s->terms[TS_INERTIA] && !dynamics_of(c)->known && s->law == TS_LAW_KALMAN && s->oscillation.tick > 0;
}

static inline ts_real within(ts_real x, ts_real low, ts_real high)
{
    return x < low ? low : x > high ? high : x;
}

static inline ts_real through_dead_zones(const ts_settings *s, ts_real z)
{
    return ts_dead_zones(z, s->dead_zone_thresholds, s->dead_zone_weights, s->dead_zones);
}

static inline ts_prior prior_of(const ts_settings *s)
{
    return (ts_prior){s->prior, s->prior_from};
}

/* Where the motion of the last command is kept; 0 before the first. */
static inline int last_slot(const ts_controller *c)
{
    return c->counters.commands > 0 ? (int)((c->counters.commands - 1) % TS_HISTORY) : 0;
}

/* According to the model, so many ticks before the one that is measured next; at rest before the first one. um. */
static inline ts_real strain_of(const ts_controller *c, int back)
{
    uint64_t ticks = c->dynamics.ticks, before = (uint64_t)back;
    return c->dynamics.strain[(ticks > before ? ticks - before : 0) % TS_HISTORY];
}

/* Number of ticks whose measurement was used or passed over. */
static inline uint64_t measured_ticks(const ts_controller *c)
{
    return dynamics_of(c)->known ? c->dynamics.ticks : c->lagged.ticks;
}

/* The model's displacement for the regressor u, um. */
static inline ts_real model(const ts_controller *c, const ts_real *u)
{
    return dot(c->w, u, TS_PADDED(c->parameters));
}

/* check.c */
TS_API ts_status ts_check(const ts_settings *s);
TS_API bool ts_same_model(const ts_settings *a, const ts_settings *b);
TS_API bool ts_same_stage(const ts_settings *a, const ts_settings *b);

/* terms.c */
TS_API int ts_column(const ts_settings *s, ts_term term);
TS_API int ts_prior_entries(const ts_settings *s, int n);
TS_API void ts_remember_creep(ts_memory *memory, const ts_settings *s);
TS_API ts_real ts_slope_of_duhem(const ts_settings *s, const ts_memory *memory, const ts_real *w, ts_real moved, bool up);
TS_API ts_real ts_before_amplifier(const ts_memory *memory, ts_real kept, ts_real x);
TS_API void ts_remember_voltage(ts_memory *memory, const ts_settings *s, ts_real kept, ts_real x);
TS_API void ts_move_voltage(ts_memory *memory, const ts_settings *s, ts_real to);
TS_API void ts_known_terms(const ts_settings *s, const ts_memory *memory, const ts_motion *d, ts_real *u);
TS_API void ts_regressor(const ts_settings *s, const ts_memory *memory, const ts_motion *d, ts_real *u);

/* command.c */
TS_API ts_real ts_of_known_terms(const ts_controller *c, const ts_motion *d);
TS_API ts_real ts_wanted_of_plays(const ts_controller *c, const ts_motion *d, ts_real known);
TS_API bool ts_rate_dependent_slopes(ts_controller *c, ts_real zdot_d);
TS_API ts_real ts_sum_of_plays(const ts_controller *c);
TS_API void ts_look_ahead_anew(ts_controller *c);
TS_API void ts_keep_command(ts_controller *c);

/* hum.c */
TS_API void ts_hum_begin(ts_hum_state *h);
TS_API void ts_hum_anew(ts_hum_state *h);
TS_API void ts_hum_tick(ts_controller *c);
TS_API void ts_hum_miss(ts_controller *c);
TS_API ts_real ts_hum_of(const ts_controller *c);
TS_API const ts_real *ts_without_hum(ts_controller *c, const ts_real *u, ts_real *y, ts_real *space);
TS_API void ts_hum_follow(ts_controller *c, ts_real innovation);
TS_API ts_real ts_power_of_hum(const ts_controller *c);
TS_API ts_real ts_without_beyond(ts_controller *c, ts_real error);
TS_API bool ts_is_hum(const ts_controller *c, ts_real frequency, ts_real amplitude);
TS_API void ts_listen(ts_controller *c, ts_real error, ts_real z, ts_real zdot_d, bool used);
TS_API void ts_forget_hum(ts_controller *c);
TS_API ts_real ts_hum_ahead(const ts_controller *c, ts_real *ahead);

/* dynamics.c */
TS_API void ts_rest_sections(ts_controller *c, ts_real strain);
TS_API ts_real ts_expected(ts_controller *c);
TS_API ts_real ts_notched(ts_controller *c, ts_real z);
TS_API ts_real ts_quiet(const ts_controller *c, ts_real innovation);
TS_API void ts_pass_stage(ts_controller *c, ts_real *u);

/* candidate.c */
TS_API void ts_candidate_tick(ts_controller *c, ts_real z, ts_real zdot_d);
TS_API void ts_candidate_end(ts_controller *c);

/* found.c */
TS_API void ts_lead_of_dead_time(int dead, ts_real *first, ts_real *second, ts_real *third, ts_real *fourth);
TS_API void ts_make_dynamics(ts_dynamics *g, ts_real frequency, ts_real tick, int dead);
TS_API void ts_adopt_resonance(ts_controller *c, ts_real frequency, ts_real highest);
TS_API void ts_begin_anew(ts_controller *c);
TS_API void ts_adopt_stage(ts_controller *c, ts_real frequency, ts_real ringing, const ts_candidate *shown);
TS_API void ts_follow_slower(ts_controller *c, ts_real x);
TS_API void ts_end_amplifier(ts_controller *c);
TS_API void ts_forget_stage(ts_controller *c);
TS_API void ts_give_up_stage(ts_controller *c);
TS_API bool ts_is_identified(const ts_controller *c);
TS_API bool ts_stage_is_shown(ts_controller *c);
TS_API void ts_watch_resonance(ts_controller *c, ts_real z, ts_real error, const ts_motion *d, bool staged);

/* ringing.c */
TS_API void ts_keep_weights(ts_controller *c, bool start);
TS_API void ts_watch_burst(ts_controller *c, ts_real error);
TS_API void ts_watch_stage(ts_controller *c, ts_real error, ts_real zdot_d, bool limited);

/* learned.c */
TS_API bool ts_was_good(const ts_controller *c);
TS_API bool ts_shows_gain(const ts_controller *c);
TS_API ts_real ts_least_slope(const ts_controller *c, ts_real rate);
TS_API void ts_take_first(ts_controller *c, bool gain_only);
TS_API void ts_move_offset(ts_controller *c, ts_real by);
TS_API void ts_keep_start(ts_controller *c);
TS_API void ts_begin_growth(ts_controller *c, bool first);
TS_API void ts_end_growth(ts_controller *c);
TS_API void ts_watch_learning(ts_controller *c, ts_real error, ts_real z_d, bool counts);
TS_API void ts_watch_kept(ts_controller *c, const ts_real *u, ts_real z);

/* adapt.c */
TS_API int ts_patience(const ts_controller *c);
TS_API void ts_pass_over(ts_controller *c);

#endif
