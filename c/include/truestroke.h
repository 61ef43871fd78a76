/* truestroke: adaptive inverse control of a rate-dependent hysteretic actuator.
 *
 * Tan, Latt, Widjaja, Shee, Riviere, Ang, "Tracking control of hysteretic piezoelectric actuator using adaptive
 * rate-dependent controller", Sensors and Actuators A 150 (2009) 116-123. Numbers in brackets are its equations.
 *
 * Contract
 * - C99, no allocation, no printing, no global state. The caller owns every struct; all of them are plain data without
 *   pointers, so that an assignment or memcpy is a complete copy: that is how a state is saved and restored.
 * - Every function is O(n) in the number of plays but for ts_rls_update, which is O(m^2) in the number of parameters.
 * - Arrays that are passed to one call may not overlap, unless the function says so.
 * - Units: displacement um, velocity um/s, voltage V at the D/A converter, weights um/V.
 * - Settings are checked once, by ts_controller_init. Not promised: any behaviour of a struct that was not initialised.
 * - TS_REAL is double or float; the whole program uses one.
 */
#ifndef TRUESTROKE_H
#define TRUESTROKE_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifndef TS_REAL
#define TS_REAL double
#endif
typedef TS_REAL ts_real;

/* Capacities; a microcontroller lowers them with -D to save memory. */
#ifndef TS_MAX_PLAYS
#define TS_MAX_PLAYS 32
#endif
#ifndef TS_MAX_DEAD_ZONES
#define TS_MAX_DEAD_ZONES 8
#endif
#ifndef TS_HISTORY /* ticks that a measurement may come after its command, plus one */
#define TS_HISTORY 64
#endif
#define TS_MAX_PARAMETERS (2 * TS_MAX_PLAYS)

typedef enum {
    TS_OK = 0,
    TS_NOT_FINITE,         /* a desired value is NaN or infinite: nothing has changed */
    TS_REJECTED,           /* a measurement was not used: see ts_flags */
    TS_BAD_PLAYS,          /* plays outside 1..TS_MAX_PLAYS */
    TS_BAD_THRESHOLDS,     /* thresholds must start at 0 and ascend */
    TS_BAD_DEAD_ZONES,     /* dead_zones outside 1..TS_MAX_DEAD_ZONES, or thresholds that do not start at 0 and ascend */
    TS_BAD_DEAD_ZONE_WEIGHTS, /* a partial sum of the dead-zone weights is not positive */
    TS_BAD_WEIGHTS,        /* an initial weight is not finite */
    TS_BAD_RATE_SCALE,     /* c_b is negative or not finite */
    TS_BAD_FORGETTING,     /* lambda outside 0 < lambda <= 1 */
    TS_BAD_REGULARIZATION, /* delta is not positive */
    TS_BAD_COVARIANCE_LIMIT, /* smaller than the trace of P(0) */
    TS_BAD_SLOPE,          /* slope_min is not positive */
    TS_BAD_VOLTAGE         /* voltage_min is not below voltage_max */
} ts_status;

/* ---- Operators ------------------------------------------------------------------------------------------------- */

/* Play operators (1): y[i] = max(x - r[i], min(x + r[i], y[i])), i = 0..n-1. r ascends from r[0] = 0. */
void ts_play_bank(ts_real x, const ts_real *r, ts_real *y, int n);

/* Weighted one-sided dead zones (4), (5): sum of w[i] S_d[i](y), with S_0(y) = y. d ascends from d[0] = 0. */
ts_real ts_dead_zones(ts_real y, const ts_real *d, const ts_real *w, int m);

/* ---- Inverse --------------------------------------------------------------------------------------------------- */

/* The voltage x for which sum of w[i] H_r[i](x) = y_d, given the play states y left by the last tick; equal to (10) and
 * (12). x -> w.H(x) is piecewise linear with the slopes s[j] = w[0] + ... + w[j], and its breakpoints y[j] +- r[j] are
 * already in order, because the states of plays that share an input are nested. Requires every s[j] > 0. O(n), one
 * division. */
ts_real ts_play_inverse(ts_real y_d, const ts_real *s, const ts_real *r, const ts_real *y, int n);

/* ---- Recursive least squares (23) -------------------------------------------------------------------------------- */

/* w += mu e, P = (P - mu u'P) / lambda with mu = P u / (lambda + u'P u), carried as a square root, P = S S' (Potter),
 * so that P stays positive semidefinite in any precision. S is m x m, row by row; at the start it is I / sqrt(delta).
 * f is m reals of scratch. Where trace P is past the limit, the division by lambda is left out for this tick.
 * Returns false, and changes neither w nor S, where u'P u or e is not finite. */
bool ts_rls_update(ts_real *w, ts_real *S, ts_real *f, const ts_real *u, ts_real e, ts_real lambda,
                   ts_real trace_limit, int m);

/* ---- Controller (Sec. 3, Fig. 5) ----------------------------------------------------------------------------------- */

typedef struct {
    int plays;                                         /* n, 1 */
    int dead_zones;                                    /* 1 */
    ts_real thresholds[TS_MAX_PLAYS];                  /* r, V */
    ts_real dead_zone_thresholds[TS_MAX_DEAD_ZONES];   /* d', um (of the inverse: they act on displacement) */
    ts_real dead_zone_weights[TS_MAX_DEAD_ZONES];      /* w_s', 1 (of the inverse) */
    ts_real initial_weights[TS_MAX_PARAMETERS];        /* w(0) = [a0, b0, a1, b1, ...], um/V */
    ts_real rate_scale;                                /* c_b, s/um */
    ts_real forgetting;                                /* lambda, 1 */
    ts_real regularization;                            /* delta, V^2: P(0) = I / delta */
    ts_real covariance_limit;                          /* largest trace of P, 1/V^2 */
    ts_real slope_min;                                 /* smallest partial slope of the inverse, um/V */
    ts_real voltage_min, voltage_max;                  /* V */
} ts_settings;

typedef struct {      /* of the last tick */
    bool saturated;   /* the command met a voltage limit */
    bool projected;   /* a partial slope was lifted to slope_min so that the inverse is defined */
    bool rejected;    /* the measurement was not finite, or too late, and was not used */
    bool held;        /* adaptation is on hold */
} ts_flags;

typedef struct {
    uint64_t commands, adaptations, saturated, projected, rejected;
} ts_counters;

typedef struct {
    ts_settings settings;
    /* command */
    ts_real w[TS_MAX_PARAMETERS];     /* (21) um/V */
    ts_real y_d;                      /* (11) um */
    ts_real slopes[TS_MAX_PLAYS];     /* partial sums of w_h(zdot_d) as the inverse used them, um/V */
    ts_real play[TS_MAX_PLAYS];       /* forward play states after the last command, V; play[0] is that command */
    /* commands that wait for their measurement: tick k is kept at k % TS_HISTORY */
    ts_real x[TS_HISTORY];            /* V */
    ts_real zdot_d[TS_HISTORY];       /* um/s */
    /* adapt */
    uint64_t lagged_tick;             /* ticks that lagged_play has seen */
    ts_real lagged_play[TS_MAX_PLAYS];/* play states at the tick that was measured last, V */
    ts_real u[TS_MAX_PARAMETERS];     /* (20) */
    ts_real innovation;               /* e_m, (15), um */
    ts_real S[TS_MAX_PARAMETERS * TS_MAX_PARAMETERS]; /* P = S S', 1/V, m x m packed at the front */
    ts_real f[TS_MAX_PARAMETERS];     /* scratch */
    bool hold;
    ts_flags flags;
    ts_counters counters;
} ts_controller;

/* Checks the settings and puts the controller at rest: plays at 0 V, w(0), P(0). */
ts_status ts_controller_init(ts_controller *c, const ts_settings *settings);

/* Back to the state after ts_controller_init. */
void ts_controller_reset(ts_controller *c);

/* Desired displacement z_d (um) and velocity zdot_d (um/s) to the command *volts, within the voltage limits. */
ts_status ts_controller_command(ts_controller *c, ts_real z_d, ts_real zdot_d, ts_real *volts);

/* Adapts the weights to a measured displacement z (um). ago: how many commands were issued after the one that z answers
 * (0: the last). Measurements come in the order of their commands; any of them may be missing. */
ts_status ts_controller_adapt(ts_controller *c, ts_real z, int ago);

/* Stops (true) and resumes (false) the adaptation; commands go on. */
void ts_controller_hold(ts_controller *c, bool hold);

#ifdef __cplusplus
}
#endif
#endif
