/* truestroke: adaptive inverse control of a rate-dependent hysteretic actuator.
 *
 * Tan, Latt, Widjaja, Shee, Riviere, Ang, "Tracking control of hysteretic piezoelectric actuator using adaptive
 * rate-dependent controller", Sensors and Actuators A 150 (2009) 116-123. Numbers in brackets are its equations.
 *
 * Contract
 * - C99, no allocation, no printing, no global state. The caller owns every struct; all of them are plain data, so that an
 *   assignment or memcpy is a complete copy: that is how a state is saved and restored. The only pointer is that of a
 *   controller to its settings, which may be in read-only memory: they stay where and as they are while it runs.
 * - A command and its inverse are O(n) in the number of plays. Adaptation is O(m^2) in the number of parameters, with
 *   both laws: ts_rls_update, ts_kalman_tick, ts_kalman_project, and so ts_controller_adapt; ts_controller_command is
 *   too at a tick at which the TS_BACKLOG-th measurement in a row is missing, and the calls that reset the state (init,
 *   reset, start). ts_controller_adapt is so once more for each tick before that of z for which it was not called: TS_BACKLOG
 *   at most, up to TS_HISTORY at the first measurement of all and where they come earlier than those before. Where no
 *   measurement came it is given NaN: its tick is then passed over at once.
 * - Arrays that are passed to one call may not overlap, unless the function says so.
 * - Units: displacement um, velocity um/s, voltage V at the D/A converter, weights um/V.
 * - Settings are checked by ts_controller_init and ts_controller_change, never in a tick. Not promised: any behaviour of a struct that was not initialised.
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

#ifndef TS_API /* before every function; c/dispatch makes the kernel static with it */
#define TS_API
#endif

/* Capacities; a microcontroller lowers them with -D to save memory. */
#ifndef TS_MAX_PLAYS
#define TS_MAX_PLAYS 32
#endif
#ifndef TS_MAX_DEAD_ZONES
#define TS_MAX_DEAD_ZONES 8
#endif
#ifndef TS_MAX_CREEPS
#define TS_MAX_CREEPS 8
#endif
#ifndef TS_HISTORY /* ticks that a measurement may come after its command, plus one */
#define TS_HISTORY 1024
#endif
#ifndef TS_BACKLOG /* ticks without a measurement, beside those that one takes to come, after which the oldest is passed over */
#define TS_BACKLOG 64
#endif
#define TS_MAX_ASYMMETRY 2
#ifndef TS_MAX_DUHEM
#define TS_MAX_DUHEM 4
#endif
#ifndef TS_MAX_OTHERS /* other axes whose motion is known; at least 1 */
#define TS_MAX_OTHERS 2
#endif

/* The terms that are known before the voltage is chosen, in the order of their weights, and how many each has at most. */
typedef enum {
    TS_CREEP,     /* first-order states of the voltage, V; weights in um/V */
    TS_LAG,       /* zdot_d; s */
    TS_INERTIA,   /* zddot_d; s^2 */
    TS_OFFSET,    /* 1; um */
    TS_ASYMMETRY, /* 4 s (1 - s), 8 s (1 - s)(1 - 2 s), s = z_d / stroke within -1 <= s <= 2; um */
    TS_DUHEM,     /* states of Duhem, V: dc / d|x| = (x - c) / length; weights in um/V */
    TS_COUPLING,         /* displacement of each other axis; um/um */
    TS_COUPLING_LAG,     /* its velocity; s */
    TS_COUPLING_INERTIA, /* its acceleration; s^2 */
    TS_TERMS
} ts_term;
#define TS_MOST_WEIGHTS {TS_MAX_CREEPS, 1, 1, 1, TS_MAX_ASYMMETRY, TS_MAX_DUHEM, TS_MAX_OTHERS, TS_MAX_OTHERS, TS_MAX_OTHERS}
#ifndef TS_MAX_PARAMETERS /* fewer than all terms together may have, where the settings are known */
#define TS_MAX_PARAMETERS (2 * TS_MAX_PLAYS + TS_MAX_CREEPS + 1 + 1 + 1 + TS_MAX_ASYMMETRY + TS_MAX_DUHEM + 3 * TS_MAX_OTHERS)
#endif
#ifndef TS_MAX_LEARNED /* weights that the Kalman filter may learn; 1 where the law is RLS */
#define TS_MAX_LEARNED TS_MAX_PARAMETERS
#endif
#ifndef TS_MAX_SENSED /* weights whose regressors may pass the sensor's lag; 1 where it has none */
#define TS_MAX_SENSED TS_MAX_PARAMETERS
#endif
#ifndef TS_SECTIONS /* of the dynamics of the stage, of each kind; at least 1 */
#define TS_SECTIONS 5
#endif
#ifndef TS_FEEDBACKS /* filters of the feedback; at least 1 */
#define TS_FEEDBACKS 13
#endif
#ifndef TS_EARS /* detectors that look for a load at the same time; at least 1, which is enough for a law that learns by RLS */
#define TS_EARS 8
#endif
#ifndef TS_HEARD /* lines that nobody has named, at most: two loads, and, where dynamics are given, two beyond their resonance */
#define TS_HEARD 4
#endif
#ifndef TS_LINES /* of hum, and those; TS_HEARD at least */
#define TS_LINES 10
#endif
#define TS_PACKED(m) ((m) * ((m) + 1) / 2) /* entries of the lower triangle of an m x m matrix, row by row */
#ifndef TS_MAX_PRIOR /* entries of the prior covariance; fewer where rows of it begin with zeros */
#define TS_MAX_PRIOR TS_PACKED(TS_MAX_PARAMETERS)
#endif

/* Sums run in lanes (lanes.h), and rows are padded with zeros to whole ones. A triangle is stored row by row: row i begins
 * at TS_ROW(i) and has TS_PADDED(i + 1) entries, of which column j is at TS_ROW(i) + j. */
#define TS_LANES 8
#define TS_PADDED(n) (((n) + TS_LANES - 1) / TS_LANES * TS_LANES)
#define TS_ROW(i) (TS_PADDED((i) + 1) * ((i) - (i) / TS_LANES * (TS_LANES / 2)))
#define TS_TRIANGLE(m) TS_ROW(m)

/* Largest desired value (um, um/s), weight and setting, so that no finite argument makes a state that is not finite; a
 * variance may be its square, and a divisor may not be below its inverse. */
#define TS_LARGEST (sizeof(ts_real) > 4 ? (ts_real)1e50 : (ts_real)1e9)

typedef enum {
    TS_OK = 0,
    TS_NOT_FINITE,           /* a desired value, or an argument of ts_controller_start, is NaN or infinite: nothing has changed */
    TS_REJECTED,             /* a measurement was not used: see ts_flags */
    TS_BAD_PLAYS,            /* plays outside 1..TS_MAX_PLAYS */
    TS_BAD_THRESHOLDS,       /* thresholds must start at 0 and ascend */
    TS_BAD_DEAD_ZONES,       /* dead_zones outside 1..TS_MAX_DEAD_ZONES, or thresholds that do not start at 0 and ascend */
    TS_BAD_DEAD_ZONE_WEIGHTS,/* a partial sum of the dead-zone weights is not positive */
    TS_BAD_TERMS,            /* a term has more weights than TS_MOST_WEIGHTS or fewer than 0, a creep coefficient outside 0 < c <= 1, or a length that is not positive */
    TS_BAD_WEIGHTS,          /* an initial weight is not finite */
    TS_BAD_RATE_SCALE,       /* c_b is negative or not finite */
    TS_BAD_RLS,              /* lambda outside 1e-3 <= lambda <= 1, delta not positive, or a limit below the trace of P(0) */
    TS_BAD_KALMAN,           /* a coefficient is out of its range, or a prior variance is not positive */
    TS_BAD_SLOPE,            /* slope_min is not positive, or not below slope_max */
    TS_BAD_VOLTAGE,          /* voltage_min is not below voltage_max, or slew is not positive */
    TS_BAD_SENSOR,           /* the delay or lag of the sensor is out of its range, or stands beside the stage's dynamics */
    TS_BAD_DYNAMICS,         /* an order or delay of the stage's dynamics is out of its range, or a coefficient is not finite */
    TS_BAD_HUM,              /* the number of lines is out of its range, one is no frequency, or the law is that of the paper */
    TS_BAD_FEEDBACK,         /* the number of filters is out of its range, or one is not stable */
    TS_BAD_LIMIT,            /* stroke, measurement_limit, smoothing or trim is out of its range */
    TS_BEYOND_REACH          /* the displacement of ts_controller_start, or the first measurement, is beyond ts_reach:
                                nothing has changed. Zero the sensor, or subtract its reading at rest. */
} ts_status;

/* ---- Operators ------------------------------------------------------------------------------------------------- */

/* Play operators (1): y[i] = max(x - r[i], min(x + r[i], y[i])), i = 0..n-1. r ascends from r[0] = 0. */
TS_API void ts_play_bank(ts_real x, const ts_real *r, ts_real *y, int n);

/* Weighted one-sided dead zones (4), (5): sum of w[i] S_d[i](y), with S_0(y) = y. d ascends from d[0] = 0. */
TS_API ts_real ts_dead_zones(ts_real y, const ts_real *d, const ts_real *w, int m);

/* a.b of n numbers, summed in lanes: sum l takes the products l, l + TS_LANES, l + 2 TS_LANES, ..., and the sums are
 * added in halves. All sums of the kernel run like this, so that they round alike with vectors of any width. */
TS_API ts_real ts_dot(const ts_real *a, const ts_real *b, int n);

/* ---- Inverse --------------------------------------------------------------------------------------------------- */

/* Weighted sum w.y of the play states y, from the partial sums s of the weights, summed by parts. */
TS_API ts_real ts_weighted_sum(const ts_real *s, const ts_real *y, int n);

/* The voltage x for which sum of w[i] H_r[i](x) = y_d, given the play states y after the last tick; equal to (10) and
 * (12). x -> w.H(x) is piecewise linear with the slopes s[j] = w[0] + ... + w[j], and its breakpoints y[j] +- r[j] are
 * already in order, because the states of plays that share an input are nested. Requires every s[j] > 0. O(n), one
 * division. */
TS_API ts_real ts_play_inverse(ts_real y_d, const ts_real *s, const ts_real *r, const ts_real *y, int n);

/* The same from the present voltage, where `gap` um are missing, and with another `change` of all slopes, um/V. */
TS_API ts_real ts_play_walk(ts_real gap, const ts_real *s, ts_real change, const ts_real *r, const ts_real *y, int n);

/* ---- Recursive least squares (23) -------------------------------------------------------------------------------- */

/* P = U D U' (Bierman): D is a diagonal of positive numbers, so that P stays positive definite in any precision. U is
 * unit upper triangular and stored by columns: column j is row j of a triangle. */
typedef struct {
    ts_real U[TS_TRIANGLE(TS_MAX_PARAMETERS)];   /* 1 */
    ts_real D[TS_PADDED(TS_MAX_PARAMETERS)];     /* 1/V^2 */
    ts_real trace;                               /* of P, 1/V^2 */
} ts_rls;

/* P = I / delta. */
TS_API void ts_rls_init(ts_rls *r, ts_real delta, int m);

/* w += mu e, P = (P - mu u'P) / lambda with mu = P u / (lambda + u'P u). Where trace P exceeds the limit, the division
 * by lambda is omitted in this tick. w and u have TS_PADDED(m) entries, those beyond m are 0. Returns false, and does
 * not change w, where u'P u or e is not finite (P is as it was), or the new P is not (nor is its trace: start it
 * anew). */
TS_API bool ts_rls_update(ts_rls *r, ts_real *w, const ts_real *u, ts_real e, ts_real lambda, ts_real trace_limit, int m);

/* ---- Bounded Kalman filter --------------------------------------------------------------------------------------- */

typedef struct {
    ts_real filter;           /* per tick: coefficient of each of two poles, with dynamics given three, that regressor and
                                 measurement pass through, at the start: see ts_kalman */
    ts_real noise_rate;       /* per tick: how fast the robust estimate of the noise follows */
    ts_real ringing_rate;     /* per tick: the same of the fast one, which makes ringing count as noise */
    ts_real model_error;      /* um: what the model cannot explain; added to the noise */
    ts_real prior_return;     /* per TS_RETURN_EVERY ticks: how far P and w return to the prior */
    ts_real change_threshold; /* mean square of the normalised innovation above which the actuator has changed */
    ts_real change_rate;      /* per update: how fast that mean follows */
    ts_real usual_rate;       /* per update: how fast the usual mean follows, to which a large one is related; 0: it is 1 */
    int refractory;           /* ticks from one change to the next */
    ts_real change_gain;      /* relative standard deviation of a change: all weights of the plays together */
    ts_real change_hysteresis;/* the same: all but the first together */
    ts_real change_share;     /* how far P returns to the prior at a change, 0..1 */
    ts_real outlier;          /* normalised innovation above which a measurement is a spike */
    int outliers;             /* spikes in a row that are rejected */
} ts_kalman_settings;

/* Covariance of the prior: the lower triangle row by row, row i without the from[i] zeros at its begin, whole blocks of
 * TS_LANES; NULL: all of it. */
typedef struct {
    const ts_real *entries;         /* squares of the units of the weights */
    const unsigned char *from;
} ts_prior;

#define TS_IN_MOTION ((ts_real)0.05) /* of slope_min: least partial slope of the inverse of Kalman weights, held at rest */
#define TS_RETURN_EVERY 16

/* A Kalman filter of weights that are an Ornstein-Uhlenbeck process about the prior (w0, P0), so that P and w stay
 * bounded under any input. w and u have TS_PADDED(m) entries, those beyond m are 0. One update takes two
 * ticks: the weights move in the first, P follows in the second, so that no tick costs more than O(m^2). */
typedef struct {
    ts_real P[TS_TRIANGLE(TS_MAX_LEARNED)];           /* whole in the blocks of eight on the diagonal */
    ts_real u1[TS_PADDED(TS_MAX_LEARNED)], u[TS_PADDED(TS_MAX_LEARNED)]; /* the regressor behind one and two poles, V or um */
    ts_real y1, y;                                       /* the measurement behind one and two poles, um */
    ts_real Pu[TS_PADDED(TS_MAX_LEARNED)];
    ts_real filter;                 /* per tick: the present coefficient of the two poles */
    ts_real disturbance;            /* um^2: of an innovation that is no error of the model: ringing */
    ts_real load;                   /* um^2: the same, of a load from outside */
    ts_real caution;                /* um^2: the same after learning has failed: see ts_guard */
    ts_real variance;               /* of the innovation of the last update, um^2 */
    ts_real sigma, ringing;         /* noise: um, um^2 */
    ts_real innovation1, innovation2; /* of the last two ticks, um */
    ts_real change;                 /* mean square of the normalised innovation */
    ts_real usual;                  /* the same, slowly: what the model does not explain at any time */
    int relates;                    /* times usual_rate: how fast it follows; 0: the innovation is not related to it */
    ts_real power, at_change;       /* um^2: mean square of the innovation, and what it was at the last change; 0: none was */
    bool steady;                    /* the tracking error has long been small: a change has to be clearer */
    bool small;                     /* the tracking error of the last window was small: a burst has only begun */
    bool calm;                      /* no stage is in the model, and the tracking error is small: large weights are no burst */
    int since_change, spikes, since_return;
    bool started, pending, changed;
    bool outgrown;                  /* input: the motion is larger than the one in which the weights were learned */
    bool renews;                    /* P is made in the next tick, of P(0) and Pu */
    unsigned char part[TS_MAX_LEARNED]; /* 1: weight of the first play, 2: of another play, 0: anything else */
} ts_kalman;

/* P0 is the covariance of the prior; sigma is the first guess of the noise, um. The caller then sets `part` and
 * `filter`. */
TS_API void ts_kalman_init(ts_kalman *k, ts_prior P0, ts_real sigma, int m);

/* The covariance is that of the prior again, and the filters start anew; the noise stays. */
TS_API void ts_kalman_reset_covariance(ts_kalman *k, ts_prior P0, int m);
/* The weights stay for so many ticks, and what is unusual is summed anew. */
TS_API void ts_kalman_wait(ts_kalman *k, int ticks);

/* As ts_kalman_reset_covariance, and the weights may be off by any share of d, which is padded with zeros, beside all else:
 * P(0) + d d'. They stay for so many ticks, 2 at least, so that P is made in the next one. */
TS_API void ts_kalman_renew(ts_kalman *k, const ts_real *d, int ticks, int m);
/* P is made now, if it waits for the next tick: for those who read it before. */
TS_API void ts_kalman_complete(ts_kalman *k, ts_prior P0, int m);

/* A sine of this amplitude (um) and frequency (cycles per tick) as noise of the law, um^2: its variance behind the filter. */
TS_API ts_real ts_kalman_noise_of_sine(const ts_kalman *k, ts_real amplitude, ts_real frequency);

/* The filters start at 0, in place of the first regressor and measurement, unless they have started. */
TS_API void ts_kalman_start_filters(ts_kalman *k, int m);

/* Weight i is independent of all others from now on, with this variance. */
TS_API void ts_kalman_separate(ts_kalman *k, int i, ts_real variance, int m);

/* Whether a measurement with this innovation is a spike; at most `outliers` in a row are. smooth: the innovation of a good
 * measurement may be as large, but `noisy`, which ts_kalman_tick is given in its place, not as sudden. */
TS_API bool ts_kalman_is_spike(ts_kalman *k, const ts_kalman_settings *s, ts_real innovation, ts_real noisy, bool smooth);

/* One tick with the regressor u, what w.u should be, y, and the innovation of the measurement. measured: false where none
 * came or it was a spike; y is then what the model expects. Returns whether w was updated. Where `learn` is false (hold, a
 * voltage limit) w stays, and the filters start anew afterwards. */
TS_API bool ts_kalman_tick(ts_kalman *k, const ts_kalman_settings *s, const ts_real *w0, ts_prior P0, ts_real *w,
                           const ts_real *u, ts_real y, ts_real innovation, bool measured, bool learn, int m);

/* Sums of the first columns of P: to the end of each block of eight; in the last block that is begun, of the first `columns`. And
 * of those whose weight is of no play. */
typedef struct {
    ts_real to_end_of[TS_PADDED(TS_MAX_LEARNED) / TS_LANES][TS_PADDED(TS_MAX_LEARNED)];
    ts_real of_rates[TS_PADDED(TS_MAX_LEARNED)]; /* of the first `summed` of the latter */
    int rate[TS_MAX_LEARNED];                    /* the latter among the first `looked`, `rates` of them */
    int columns, summed, looked, rates;
} ts_column_sums;

/* Moves w in the metric of P so that g.w grows by `missing`: w += P g missing / (g.P g). g is 1 for each of the first
 * `columns` weights, but `rate` for those of no play. `sums`, at first of 0 columns, belongs to this P: a further call adds
 * the columns that it lacks, or where it has more goes on from the last block that it needs whole. */
TS_API void ts_kalman_project(const ts_kalman *k, ts_real *w, ts_column_sums *sums, int columns, ts_real rate, ts_real missing,
                              int m);

/* ---- Self-excited oscillation -------------------------------------------------------------------------------------- */

#define TS_HALF_WAVES 12
#define TS_PI ((ts_real)3.14159265358979323846)

typedef struct {
    ts_real tick;        /* s; 0: the detector is off */
    ts_real corner;      /* cycles per tick: the highest frequency that is looked for */
    ts_real fast, slow;  /* per tick: coefficients of the poles between which the error passes */
    ts_real motion_rate; /* per tick: how fast the means of the motion follow */
    ts_real noise_share; /* of the noise of a measurement, three standard deviations between the poles */
    ts_real floor, large;/* um: an oscillation below `floor` is ignored, one above `large` need not grow */
} ts_oscillation_settings;

/* Finds an oscillation of the error that grows, faster than the motion and slower than the corner of the law's filter:
 * then the law excites a resonance of the stage. Of each half-wave of the error between the poles the peak and the
 * length are kept. */
typedef struct {
    ts_real fast, slow, slower;     /* um: error after one pole; its slow part, the motion's */
    ts_real speed, acceleration;    /* um/s: means of |zdot_d| and of |its change in a tick| */
    ts_real zdot_d;                 /* of the tick before, um/s */
    ts_real error, h;               /* um: of the tick before, and between the poles */
    ts_real time;                   /* s: since the start */
    ts_real peak, steepest;         /* um, um per tick: of this half-wave so far */
    ts_real peaks[TS_HALF_WAVES];   /* um: of the half-waves before it, the newest first */
    int lengths[TS_HALF_WAVES];     /* ticks: of the same */
    int sign, length;               /* of this half-wave; sign 0: none has begun */
    int missed;                     /* ticks before this one of which there is no error */
    int regular;                    /* half-waves before it of about one length, up to TS_HALF_WAVES */
    bool started, found;
} ts_oscillation;

/* A tick without a measurement (NULL), or the error of one that was rejected: it is checked for a jump only. */
TS_API void ts_oscillation_miss(ts_oscillation *o, const ts_oscillation_settings *s, const ts_real *error);

/* One tick: error (um), motion (um/s), standard deviation of a measurement (um), whether weights were good. Returns the frequency of
 * an oscillation that grows, cycles per tick, or 0. */
TS_API ts_real ts_oscillation_tick(ts_oscillation *o, const ts_oscillation_settings *s, ts_real error, ts_real zdot_d,
                                   ts_real noise, bool learned);

/* Cycles per tick of the last n half-waves, 1 <= n <= o->regular. */
TS_API ts_real ts_oscillation_frequency(const ts_oscillation *o, int n);
/* Whether a ringing of this frequency, cycles per tick, is faster than 2.5 times the motion. */
TS_API bool ts_oscillation_is_fast(const ts_oscillation *o, ts_real frequency);

/* ---- Never worse than not learning ---------------------------------------------------------------------------------- */

typedef struct {
    int window;          /* ticks over which an error is taken; 0: the guard is off */
    ts_real range_rate;  /* per tick: how fast the range of the motion shrinks to that of the present motion */
    ts_real floor;       /* um: an error below it is no failure */
    ts_real burst;       /* times the motion so far: before anything was good, an error beyond it is a burst; 0: none is */
    int recall;          /* ticks of a block in which kept weights are compared with measurements after a large error; 0: they are not */
} ts_guard_settings;

#define TS_SETTLED 20       /* windows with a small error: weights that are kept are then worth a return after a large one */
#define TS_SWINGS 2         /* half-waves of the error that grow: one more, beyond the motion so far, is driven by learning */
#define TS_FIRST_WAIT 4     /* windows of the first hold, */
#define TS_LONGEST_WAIT 256 /* and of the longest */
#define TS_LONGEST_RECALL 1000000 /* ticks of a block in which kept weights are compared */

typedef enum {
    TS_GUARD_NOTHING,
    TS_GUARD_KEEP,       /* the weights are the best of late: keep them */
    TS_GUARD_RESTORE,    /* learning has failed: set the present weights aside, and hold the kept ones */
    TS_GUARD_FIRST,      /* the kept ones are no better: hold those of the start */
    TS_GUARD_ADOPT,      /* what was held is better: learn on from there, with caution */
    TS_GUARD_RETURN      /* it is not: the weights that were set aside again; learning was not the cause */
} ts_guard_action;

/* Values, um, as sums of what each is more than the first one: a large mean then takes no digits of their spread. */
typedef struct {
    ts_real first, sum, square; /* um, um, um^2 */
    int counted;
} ts_spread;

/* Compares the tracking error of the weights that learn with that of the weights at their best, both over the range of the
 * motion, window by window; an error is the standard deviation of z - z_d in a window. */
typedef struct {
    ts_real low, high;      /* um: of the motion, over about a second */
    ts_real start;          /* um: the first error */
    ts_real ringing;        /* um: an error below it is ringing that decays, no failure */
    ts_real error;          /* of the window before, over the range */
    ts_real best;           /* least error over the range while it learned; rises slowly */
    ts_real failed;         /* error over the range at which learning has failed */
    ts_real drift;          /* um per tick: of the offset while the law does not learn, so that the mean error vanishes */
    ts_real span;           /* um: range of the motion when weights were kept, or, before, in the window before */
    ts_real swing, swung;   /* um: largest error since its sign changed, and how large it was on the other side before */
    ts_real promised;       /* error over the range that the weights to be restored had when they were asked last; 0: not asked */
    ts_real entered;        /* error over the range when a stage entered the model; 0: none has since the last hold */
    int ticks;              /* of this window */
    int bad;                /* windows in a row in which it was too large and did not fall */
    int good;               /* windows in a row in which it was not */
    int held;               /* windows since weights were restored; 0: it learns */
    int wait;               /* windows: of the next hold */
    int pause;              /* windows in which no failure counts */
    int small;              /* windows in a row in which the error was small, its mean included */
    int swings;             /* half-waves of the error in a row, each of them larger than the one before */
    bool kept, at_start, started;
    bool grown;             /* the motion no longer grew in the window before, until weights were kept */
    bool settled;           /* the error had been small for long when weights were kept, */
    bool lost;              /* and was large since then: others are kept when it has been small for long again */
    ts_spread errors;       /* in this window, where they count, */
    ts_spread missed;       /* and of what the weights to be restored miss in it */
} ts_guard;

/* How well the kept weights predict the measurements, while the model is lost. */
typedef struct {
    ts_real low, high; /* um: of what they predict, */
    ts_real rose, fell; /* and how far it went up and down */
    ts_spread missed;  /* of what they miss */
} ts_recall;

/* The gain of the first weights, until others were good: measured displacements over those that they predict, without what
 * oscillates, by least squares. */
typedef struct {
    ts_real product, square; /* um^2: sums over the ticks */
    ts_real first, from;     /* um: the first measurement, and what was predicted then */
    ts_real z, expected;     /* um: measured and predicted since, behind a slow pole */
    ts_real unused;          /* as long as ts_recall */
    int ticks;               /* 0: none yet */
} ts_first_gain;

/* Learning begins anew, with other weights: nothing is held, and what is kept stays. */
TS_API void ts_guard_begin(ts_guard *g);

/* The kept weights are taken again, as if nothing had happened since. */
TS_API void ts_guard_recall(ts_guard *g);

/* One tick in which the kept weights predict z, um, and miss the measurement by so much; the range of the motion and the noise, um.
 * Whether they are as good as they were, but for an offset: it is then in *offset, um. */
TS_API bool ts_recall_tick(ts_recall *r, const ts_guard_settings *s, ts_real z, ts_real missed, ts_real range, ts_real noise, ts_real *offset);

/* The range of the motion, um: at least ten times the floor. */
TS_API ts_real ts_guard_range(const ts_guard *g, const ts_guard_settings *s);

/* Before the tick: by how much the weights that would be restored miss its measurement, um. They are asked after a window that was
 * bad, and are restored only where they promise to be better. Those of which nothing is known are restored. */
TS_API void ts_guard_compare(ts_guard *g, ts_real missed);

/* Whether the weights that would be restored miss less than half of this error over the range. */
TS_API bool ts_guard_promises(const ts_guard *g, ts_real error);

/* One tick with the error z - z_d and the motion z_d, um; `counts`: the measurement was used, and no voltage limit explains
 * the error. noise: standard deviation of a measurement, um. */
TS_API ts_guard_action ts_guard_tick(ts_guard *g, const ts_guard_settings *s, ts_real error, ts_real z_d, bool counts, ts_real noise);

/* ---- Dynamics of the stage, between hysteresis and sensor --------------------------------------------------------- */

#define TS_TAPS 5

/* G(q): from the displacement that the hysteresis gives in a tick, its strain, to the measurement of that tick. Its static
 * gain is 1. */
typedef struct {
    bool known;
    ts_real first;                    /* cycles per tick: the first resonance, where the settings know it */
    int sections;
    ts_real section[TS_SECTIONS][4];  /* b0, b1, a1, a2 of (b0 + b1 q^-1) / (1 + a1 q^-1 + a2 q^-2): G is q^-dead times the sum
                                         of the sections and of direct[i] q^-i */
    ts_real direct[3];
    int dead;                         /* ticks */
    ts_real notch[3];                 /* sum of notch[i] q^-i: the denominator of the first mode, 1 at 0 Hz */
    int modes;                        /* beside the first one; A(q) is notch times */
    ts_real mode[TS_SECTIONS][5];     /* (b0 + b1 q^-1 + b2 q^-2) / (1 + a1 q^-1 + a2 q^-2) of each of them, 1 at 0 Hz: its poles become zeros */
    ts_real quiet[3];                 /* notch times a factor: the second difference of white noise stays as large */
    ts_real tap[TS_TAPS];             /* A G = q^-dead (sum of tap[i] q^-i + sum of the first `others` sections rest[i]), which does */
    int others;                       /* not resonate */
    ts_real rest[TS_SECTIONS][4];     /* b0, b1, a1, a2, as above */
    ts_real amplifier;                /* share of the last tick's voltage that the amplifier's lag keeps; 0: none. It is before the hysteresis */
    ts_real lead[2];                  /* s, s^2: 1 / G without the sensor, for slow motion, is 1 + lead[0] s + lead[1] s^2 */
    ts_real sensor[2];                /* s, s^2: a slow motion is measured as 1 + sensor[0] s + sensor[1] s^2 times it */
} ts_dynamics;

/* The sensor where the stage is not known: a measurement shows the displacement `ticks` ago, of which `share` is that of the
 * tick before, behind a first-order lag. With the stage it is in ts_dynamics, and here all is 0. */
typedef struct {
    int ticks;                        /* whole ticks of its delay */
    ts_real share;                    /* of a tick: the rest of the delay, 0..1 */
    ts_real lag;                      /* ticks: time constant of the first-order lag; 0: none */
    ts_real pole, now, before;        /* the lag at the end of a tick is pole times that of the tick before, + now u[k] + before u[k-1] */
    ts_real slow[2];                  /* s, s^2: a slow motion is measured as 1 + slow[0] s + slow[1] s^2 times that `ticks` ago */
} ts_sensor;

typedef struct {
    ts_real before[TS_PADDED(TS_MAX_SENSED)]; /* the regressor of the tick before, um */
    ts_real lagged[TS_PADDED(TS_MAX_SENSED)]; /* behind the lag, at the end of that tick */
} ts_sensor_state;

/* Fast feedback: the sum of biquads of the error, (b0 + b1 q^-1 + b2 q^-2) / (1 + a1 q^-1 + a2 q^-2), is added to the
 * displacement that is asked of the hysteresis. */
typedef struct {
    int filters;
    ts_real filter[TS_FEEDBACKS][5];  /* b0, b1, b2, a1, a2 */
    ts_real most;                     /* um: of their sum */
} ts_feedback;

typedef struct {
    ts_real state[TS_FEEDBACKS][2];   /* um */
    ts_real damping[5], damped[2];    /* Kalman: b0, b1, b2, a1, a2 of what damps a stage that was found, and its states, um */
    ts_real side, since, swings;      /* of the damping: where it was large last, -1 or 1, ticks since it turned there, swings in a row */
    ts_real peak, first;              /* of the damping, um: the largest of this swing, and of the first one that counts */
    ts_real sum;                      /* um */
    ts_real alarms;                   /* Kalman: sudden changes per second, over the last tenth of one */
    bool paused;                      /* while there are many: the model is not yet, or no longer, what the margins count with */
} ts_feedback_state;

typedef struct {
    ts_real section[TS_SECTIONS][2];  /* outputs of the sections in the last two ticks, um */
    ts_real strain[TS_HISTORY];       /* inputs: of tick k at k % TS_HISTORY, um */
    ts_real z[2];                     /* what the notch saw in the last two ticks, um */
    ts_real mode[TS_SECTIONS][2];     /* of A, um */
    ts_real innovation[2];            /* innovations of the last two ticks, um */
    ts_real tap[TS_TAPS - 1][TS_PADDED(TS_MAX_LEARNED)]; /* of A G, which the regressor passes */
    ts_real rest[TS_SECTIONS][2][TS_PADDED(TS_MAX_LEARNED)];
    uint64_t ticks;                   /* whose measurement is in them */
    bool started;                     /* the regressor has passed; */
    bool stands;                      /* until then the notch is at rest, as at the start */
} ts_dynamics_state;

/* ---- Inertia that is measured --------------------------------------------------------------------------------------- */

/* Where the stage is not known and the model has the term of the inertia: while the error shows that the stage rings, velocity
 * and acceleration of the law's regressor are those of the measurement, as central differences about the tick before. */
typedef struct {
    ts_real u[TS_PADDED(TS_MAX_LEARNED)]; /* the regressor of the tick before; with a stage in the model, behind a third pole, */
    ts_real y;                        /* um: and what w.u should have been, or is there */
    ts_real error[2];                 /* um: measured less desired, of the last two ticks, the newer first */
    ts_real once, twice[2];           /* um: behind the first of the two poles, and behind both in the last two ticks */
    ts_real power;                    /* um^2: mean square of the second difference of that */
    bool started, rings;
} ts_ringing;

/* ---- A steady tone in the error: a load from outside ------------------------------------------------------------------ */

/* A stage that rings decays, and what the motion excites again and again is a harmonic of it. A tone that does neither comes from
 * outside: a pump, the mains, another axis. Its amplitude and phase are followed in blocks of four periods of a frequency, each half a
 * block after the last one, weighted as 1 - cos over a block. */
typedef struct {
    ts_real step[2], turn[2];         /* of a phasor that turns once in a block: in a tick, and now */
    ts_real sum[2][2], before[2][2];  /* um: of blocks that go on; of the last two that ended, the newer first */
    ts_real advance[2], product[2];   /* um^2: of blocks half a block, and a block, after each other */
    ts_real power[2];                 /* um^2: squares of the later and the earlier of the latter */
    ts_real rate, first, last;        /* um/s: desired, in the last tick; ticks: when it turned upwards */
    int block, ticks, blocks;         /* ticks of a block, and of the one that goes on; blocks that have ended */
    int passed, turns;                /* ticks, and turns upwards */
} ts_tone;

#define TS_STEADY_TONE ((ts_real)0.95) /* of the square of a block: its product with the one before, where a tone is no ringing: it neither decays nor grows */
#define TS_OFF_HARMONIC ((ts_real)0.04)  /* of the motion's frequency: what is nearer to a harmonic is not distinguished from it, */
#define TS_OFF_HARMONIC_OF_STAGE ((ts_real)0.12) /* nor this from one that grows or shrinks where the stage rings at it */
#define TS_ORDERS_OF_STAGE ((ts_real)40.5) /* of a harmonic of the motion, as 840 Hz of lines of 40 Hz, at which the stage rings */
#define TS_OF_LOAD ((ts_real)0.35) /* of the frequency of a load: what is shown so near to it is the load */

/* Anew, about this frequency, cycles per tick. */
TS_API void ts_tone_begin(ts_tone *t, ts_real centre);

/* One tick: measured less desired (um), desired rate (um/s). */
TS_API void ts_tone_tick(ts_tone *t, ts_real error, ts_real zdot_d);

/* The frequency of a tone that is so `steady`, and not within `off` of a harmonic of the motion up to `orders`, cycles per tick; 0: there is
 * none. */
TS_API ts_real ts_tone_of_load(const ts_tone *t, ts_real steady, ts_real orders, ts_real off);

/* Of what is about the frequency: its amplitude, um. */
TS_API ts_real ts_tone_amplitude(const ts_tone *t);

/* ---- Hum: sines of known frequency from outside ---------------------------------------------------------------------- */

/* Their amplitudes follow what the model does not expect, as those of an adaptive noise canceller (Widrow et al. 1975). The law learns
 * from regressor and measurement without what has their frequencies: else it would take what the command does against them for a
 * property of the actuator. */
typedef struct {
    ts_real line[TS_LINES][3];        /* of each: cosine and sine of its angle in a tick, and 1/s */
    int lines;
} ts_hum;

typedef struct {
    ts_real centre;                   /* cycles per tick: about which a load is looked for; 0: it has not begun */
    ts_real power;                    /* um^2: sum of squares of what is looked at, beyond the resonance */
    ts_tone tone;
    int of_error;                     /* 1: in the error, in place of what the first weights do not explain */
} ts_ear;

typedef struct {
    ts_real expected, z;              /* um: means of the plays with their first weights, and of the measurement, */
    ts_real square, product;          /* um^2 s: and what was summed beside them; 0: it has not begun */
} ts_unexplained;

typedef struct {
    ts_real line[3];                  /* cosine and sine of its angle in a tick, and 1/s; 0: none was heard */
    ts_real announced, age;           /* um: amplitude with which it was heard; s: since then */
    ts_real fed_back[2];              /* um: cosine and sine of what the error has of it, where it is kept from the feedback */
    ts_real beyond;                   /* 1: it is beyond the resonance of given dynamics, and kept from the law; 0: a load */
    ts_real error[2], first[2];       /* um: what the error has of it, and the other signal in which loads are heard */
} ts_load;

typedef struct {
    ts_real turn[TS_LINES][2];        /* cosine and sine at the tick that was measured last */
    ts_real sine[TS_LINES][2];        /* um: their amplitudes */
    ts_load heard[TS_HEARD];          /* lines that nobody has named */
    ts_real refused[TS_HEARD][2];     /* 1/s, s: lines that were dropped, and for how long they are not heard again */
    ts_real over[TS_LINES];           /* s: at the bound of the amplitude, without a break */
    ts_real subtracted;               /* um: of the last command */
    ts_unexplained unexplained;
    ts_ear ear[TS_EARS];
    ts_ear beyond;                    /* that looks beyond the resonance of given dynamics */
    ts_real regressor[TS_LINES][2][TS_PADDED(TS_MAX_PARAMETERS)]; /* V or um: what has the frequency of each line in the regressor of the law */
    ts_real measurement[TS_LINES][2]; /* um: in what belongs to it */
} ts_hum_state;

/* ---- The first resonance from what is measured anyway ---------------------------------------------------------------- */

#define TS_SHOWN 7                    /* plays that stand for the hysteresis */
#define TS_MEASURED 4                 /* three derivatives of the measurement, and itself */
#define TS_RESONANCE (TS_SHOWN + TS_MEASURED)
#define TS_LOWEST_RESONANCE 40       /* Hz: where the search for it ends */
#define TS_DRIVEN_ALONE ((ts_real)0.95) /* share of the plays in a resonance that is not a load which the command answers */
#define TS_MOST_POINTED 3 /* windows that point elsewhere, between two that show a resonance, or in a search */
#define TS_HIGHEST_RESONANCE ((ts_real)0.4) /* cycles per tick: a higher one is not seen */

/* Least squares of z + c1 z' + c2 z'' = sum of w[i] times play i, all behind the same band about `centre`, window by window. c2 is
 * 1 / w0^2; the next window is about the resonance that was shown, or that the window points to, or lower where there was none. */
typedef struct {
    ts_real centre;                   /* cycles per tick; 0: the first window has not begun */
    ts_real known, variance;          /* cycles per tick, and its relative variance; 0: not known */
    ts_real lag;                      /* ticks of dead time and lag behind the plays, where it is known, */
    ts_real first_order;              /* and ticks of a first-order lag, for all of it */
    ts_real motion, power;            /* of the last window: cycles per tick of the motion, um^2 of the error */
    ts_real driven;                   /* of the last window that showed it: share of the residual of ringing alone that the plays explain, */
    ts_real sensitivity;              /* and how far fewer plays move it, over it */
    ts_real swept;                    /* cycles per tick: where the search goes on behind a window about what is known; 0: about that */
    ts_real motion_filter[3], noise_filter[3];
    ts_real first[TS_SHOWN + 1];      /* of the plays, V, and of the measurement, um */
    ts_real state[TS_SHOWN + 1][4];   /* of both filters */
    ts_real last_filter, last[TS_SHOWN + 3]; /* a pole behind them, and what it holds */
    ts_real sum[TS_PACKED(TS_RESONANCE)]; /* of products, packed: plays, three derivatives of the measurement, and itself */
    ts_real of_noise[TS_PACKED(TS_MEASURED)]; /* the same of what is measured, for each sample of white noise of 1 um */
    ts_real impulse[4], last_impulse[3]; /* of both filters and the pole, for that */
    ts_real before[4], fourth;        /* um: measurements before this one, less the first; sum of magnitudes of their fourth difference */
    ts_real speed, change;            /* um/s: sums of |zdot_d| and of |its change in a tick| */
    ts_real error;                    /* um^2: sum of squares */
    ts_real load, load_at;            /* um, cycles per tick: amplitude and frequency of a load; 0: none is seen */
    int settling, window, ticks;      /* of this window: before it counts, that count, so far */
    int windows, pointed;             /* that made it known; that pointed elsewhere since one did, or since the search began */
    bool strange, again;              /* the last one differed from what is known; the next search begins above */
    ts_tone tone;
} ts_resonance;

/* Tangent of 0 to 1.3; arctangent of a number above 0, 0 of one whose square overflows. */
TS_API ts_real ts_tangent(ts_real x);
TS_API ts_real ts_arctangent(ts_real x);

/* Where the search ends, cycles per tick: 40 Hz, or twice the frequency of the motion. tick: s. */
TS_API ts_real ts_resonance_lowest(const ts_resonance *r, ts_real tick);

/* The next window is about this frequency, cycles per tick, where it is one of the search. */
TS_API void ts_resonance_look(ts_resonance *r, ts_real frequency);

/* What a window is looked at for. */
typedef struct {
    ts_real range;                    /* um: of a motion that is followed well enough to lose by a stage that is wrong; or 0 */
    ts_real highest;                  /* cycles per tick: a resonance above it is not the first */
    ts_real burst;                    /* um^2: mean square of an error for which the estimate makes haste; 0: for none */
    ts_real loudest;                  /* um^2: mean square of an error from which on a tone is no load, */
    ts_real least;                    /* and below which nothing is shown */
    ts_real steady;                   /* of the square of a block: from which share on a tone is a load, */
    ts_real driven;                   /* and of the plays: from which on, in less than two periods of the motion, it is none; 1: never */
    ts_real noise;                    /* um^2: mean square of the noise of a measurement, at most */
    const ts_real *expected;          /* um/V: weights of the plays, read in the tick in which the window ends; NULL: not known */
} ts_search;

/* A stage that is shown, before it is in the model: what it would have missed in a window of the estimate, beside what the law misses, and
 * by what that is less: the weights beside the stage. */
typedef struct {
    ts_real frequency;                /* cycles per tick; 0: there is none */
    ts_real section[4], direct;       /* of its dynamics */
    ts_real strain, made[2];          /* um: of the tick before; what the section made of it then, and before that */
    ts_real first, ticks;             /* um: what it makes in the first tick; so many so far, and sums: */
    ts_real missed[2], speed[2], level[2], own[2]; /* of what it misses, the velocity, what it makes beyond the first, and what the law misses, and of their squares, */
    ts_real missed_speed, missed_level, speed_level; /* and of products */
    ts_real shown;                    /* cycles per tick: the one of the last window; 0: there was none, or it shows no gain and lag, */
    ts_real gain, lag, offset;        /* 1, s, um: what it misses least with, beside the weights; without a dead time */
    ts_real worse;                    /* cycles per tick: one that missed much more than the law in the last window; 0: none did */
} ts_candidate;

/* One tick: plays (V) and measurement (um), error (um), desired rate (um/s) and its change. Returns whether a window has ended that
 * adds to what is known. In a burst 20 periods are enough, and one of a low centre ends at once. tick: s. */
TS_API bool ts_resonance_tick(ts_resonance *r, ts_real tick, const ts_real *x, ts_real error, ts_real zdot_d, ts_real change,
                              const ts_search *search);

/* Whether the next tick ends a window whose mean square error is between these, um^2. */
TS_API bool ts_resonance_ends(const ts_resonance *r, ts_real above, ts_real below);

/* Whether there were enough windows: two, or one that is as sure as any can be. */
TS_API bool ts_resonance_suffices(const ts_resonance *r);

/* Of the window that has just ended: mean square of what inertia and damping explain of the measurement beside the plays, in the
 * window's band, um^2. */
TS_API ts_real ts_resonance_ringing(const ts_resonance *r);

/* ---- Controller (Sec. 3, Fig. 5) ----------------------------------------------------------------------------------- */

typedef enum { TS_LAW_RLS, TS_LAW_KALMAN } ts_law;

/* Parameters: [a0, b0, a1, b1, ...] of (21), b_i where rate_dependent[i]; then the weights of the known terms, in
 * the order of ts_term. */
typedef struct {
    /* model */
    int plays;                                         /* n, 1 */
    int dead_zones;                                    /* 1 */
    int terms[TS_TERMS];                               /* number of weights of each known term, 1 */
    bool rate_dependent[TS_MAX_PLAYS];                 /* whether play i has a rate weight b_i */
    ts_real thresholds[TS_MAX_PLAYS];                  /* r, V */
    ts_real dead_zone_thresholds[TS_MAX_DEAD_ZONES];   /* d', um (of the inverse: they act on displacement) */
    ts_real dead_zone_weights[TS_MAX_DEAD_ZONES];      /* w_s', 1 (of the inverse) */
    ts_real creep[TS_MAX_CREEPS];                      /* 1 - exp(-T / tau) of each first-order state of the voltage */
    ts_real duhem[TS_MAX_DUHEM];                       /* length of each state of Duhem, V: so far the voltage moves until it has forgotten */
    ts_real rate_scale;                                /* c_b, s/um */
    ts_real stroke;                                    /* um */
    ts_real initial_weights[TS_MAX_PARAMETERS];        /* w(0), um/V; known terms: see ts_term */
    /* law */
    ts_law law;
    ts_real forgetting;                                /* RLS: lambda, 1 */
    ts_real regularization;                            /* RLS: delta, V^2: P(0) = I / delta */
    ts_real covariance_limit;                          /* RLS: largest trace of P, 1/V^2 */
    ts_kalman_settings kalman;
    ts_real prior[TS_MAX_PRIOR];                       /* Kalman: entries of P0: see ts_prior */
    unsigned char prior_from[TS_MAX_PARAMETERS];       /* Kalman: where its rows begin */
    ts_real first_noise;                               /* Kalman: first guess of the noise, um */
    ts_oscillation_settings oscillation;               /* Kalman */
    ts_guard_settings guard;                           /* Kalman */
    ts_real resonance;                                 /* Kalman: first of the stage, cycles per tick; 0: not known */
    ts_dynamics dynamics;                              /* Kalman */
    ts_sensor sensor;
    ts_feedback feedback;
    ts_hum hum;                                        /* Kalman */
    /* safety */
    ts_real slope_min, slope_max;                      /* partial slopes, um/V; Kalman: of the weights, and of the inverse
                                                          from TS_IN_MOTION * slope_min on */
    ts_real velocity_limit;                            /* Kalman: slopes are admissible at every rate that was commanded, up
                                                          to this one, um/s */
    ts_real voltage_min, voltage_max;                  /* V */
    ts_real slew;                                      /* largest step of the voltage, V per tick; may be infinite */
    ts_real measurement_limit;                         /* a measurement beyond it is rejected, um */
    ts_real smoothing;                                 /* 0 <= s < 1: share of a learned change that the command still
                                                          lacks a tick later */
    ts_real trim;                                      /* integral of the error into the command, per tick; 0 is off */
} ts_settings;

typedef struct {      /* of the last tick */
    bool saturated;   /* the command met a voltage limit */
    bool projected;   /* a partial slope was limited to its limits so that the inverse is defined */
    bool rejected;    /* the measurement was not finite, beyond its limit, a spike, frozen or too late: not used */
    bool held;        /* adaptation is on hold */
    bool changed;     /* the actuator has changed suddenly */
    bool slewed;      /* the command met the slew limit */
    bool oscillating; /* self-excited oscillation: adaptation pauses until its frequency is measured */
    bool restored;    /* learning made the error larger: earlier weights are held */
} ts_flags;

typedef struct {
    uint64_t commands, adaptations, saturated, projected, rejected, changed, slewed, oscillating, restored;
} ts_counters;

/* States of the model that depend on the voltage: the same for the tick that is commanded and for the one that is
 * measured. */
typedef struct {
    uint64_t ticks;                /* so far */
    ts_real play[TS_MAX_PLAYS];    /* play states, V; play[0] is the voltage of the last tick */
    ts_real creep[TS_MAX_CREEPS];  /* first-order states, V */
    ts_real duhem[TS_MAX_DUHEM];   /* states of Duhem, V */
} ts_memory;

/* After so many limited ticks beyond the desired displacement the model is considered wrong, not the limit. */
#define TS_BEYOND 10

/* Lags of an amplifier that a stage may be found behind. */
#define TS_SLOWER 4

/* Ticks of lag and dead time of a stage that was found, at most; where dynamics are given it has those of theirs. */
#define TS_MOST_DEAD 8

/* While a stage that was found is in the model: the error, over the range of the motion, in blocks of a quarter of a second, and
 * the weights with the least of them. All are ts_real, for they share the memory of weights. */
typedef struct {
    ts_real ticks, windows;        /* of this block: so far, */
    ts_real speed, square;         /* um^2/s^2: sum of zdot_d^2, and of the squares of the windows' errors */
    ts_real least, swift;          /* error and speed of the block with the least error; */
    ts_real known;                 /* 1: there is one */
    ts_real bad;                   /* blocks in a row whose error has grown */
    ts_real failed;                /* error for which earlier weights were taken, */
    ts_real held;                  /* windows since; 0: the law learns; */
    ts_real good;                  /* error of those weights; 0: not known yet */
    ts_real wait;                  /* blocks: of the next hold, */
    ts_real left;                  /* and until this one ends, or until an error may have grown */
    ts_real late;                  /* 1: the law has a third pole */
    ts_real pace, paced;           /* um^2/s^2: sum of zdot_d^2 in this window, and in the one before, */
    ts_real before;                /* and its error; 0: not known */
    ts_real rising;                /* windows in a row whose error has risen */
} ts_growth;

/* The stage's first resonance, and the quantities that follow from it; at first from the settings. */
typedef struct {
    ts_real resonance;             /* cycles per tick; 0: not known */
    ts_real inertia;               /* 1 / (w0^2 T), s: displacement that a change of zdot_d in a tick takes */
    ts_real smoothing;             /* as in the settings */
    ts_real rest;                  /* ticks until learning begins again */
    ts_real age;                   /* s since `newer` was kept */
    ts_real newer[TS_MAX_LEARNED]; /* earlier weights, to be restored; with a stage that was found those with the least error */
    union {
        ts_real older[TS_MAX_LEARNED];
        ts_growth growth;          /* with a stage that was found */
    } before;
    ts_real doubt;                    /* error over the range that the dynamics of the settings leave */
    ts_real widest;                   /* um: range of the motion so far, while the stage is known */
    ts_real given_up;                 /* cycles per tick: of a stage with which learning has failed; 0: with none */
    uint64_t since;                   /* first tick whose strain is kept while learning rests */
    bool failed, trial;               /* with the stage that was found learning has failed, or has not been better than before yet */
    int doubted;                      /* windows in which that error has not fallen */
} ts_stage;

/* What is wanted of a tick. */
typedef struct {
    ts_real z_d;                   /* um */
    ts_real zdot_d;                /* um/s */
    ts_real zddot_d;               /* um/s^2 */
    ts_real ahead;                 /* um: what the stage's dynamics ask of the hysteresis beyond z_d */
    ts_real others[TS_MAX_OTHERS][3]; /* um, um/s, um/s^2: of each other axis; 0 where it is not known */
} ts_motion;

#define TS_KEEP 0.03 /* s: how often the weights are kept */

typedef struct {
    const ts_settings *settings;      /* the caller's */
    int parameters, of_plays;         /* m, and how many of them belong to plays */
    /* command */
    ts_real w[TS_PADDED(TS_MAX_PARAMETERS)]; /* (21) and the terms */
    ts_real bumpless;                 /* um: bumpless transfer: learned, not yet in the command */
    ts_real handed;                   /* um: the same of what the feedback hands over */
    ts_real integral;                 /* um: the trim */
    ts_real y_d;                      /* (11) less the known terms, um */
    ts_real fastest;                  /* largest rate so far, at most velocity_limit, um/s */
    ts_real slopes[TS_MAX_PLAYS];     /* partial sums of w_h(zdot_d) as the inverse used them, um/V */
    ts_memory now;
    /* commands that wait for their measurement: tick k is kept at k % TS_HISTORY */
    ts_real x[TS_HISTORY];            /* V */
    ts_motion motion[TS_HISTORY];
    bool limited[TS_HISTORY];         /* the voltage met a limit: the tick is not used, but see beyond */
    /* adapt */
    int answered;                     /* commands up to that of the last measurement that was given, it included; 0: none was */
    ts_memory lagged;
    ts_real u[TS_PADDED(TS_MAX_PARAMETERS)]; /* (20) and the terms */
    ts_real innovation;               /* e_m, (15), um */
    ts_real z_before;                 /* um: the last measurement that differed from the one before it, */
    ts_real predicted_before;         /* and the model's value then */
    ts_real resolution;               /* um: the smallest step from one measurement to a different one; 0: none so far */
    int beyond;                       /* ticks at a voltage limit with z beyond z_d since one not limited, up to TS_BEYOND */
    union {
        ts_rls rls;
        ts_kalman kalman;
    } law;
    ts_ringing ringing;               /* Kalman */
    ts_oscillation oscillation;       /* Kalman */
    ts_stage stage;                   /* Kalman */
    ts_resonance resonance;           /* Kalman */
    ts_candidate candidate;           /* Kalman */
    ts_real shown[TS_SHOWN];          /* V: of the plays in the tick before, for it, */
    ts_real rate;                     /* um/s: and zdot_d */
    ts_real slower[TS_SLOWER];        /* V: that of `lagged`, behind lags of which one may be the amplifier's; Kalman */
    ts_guard guard;                   /* Kalman */
    struct {
        ts_real first[TS_MAX_LEARNED];                       /* weights of the start, */
        ts_real w[TS_PADDED(TS_MAX_LEARNED)], aside[TS_MAX_LEARNED]; /* at their best, and those that failed */
        ts_real P[TS_PACKED(TS_MAX_LEARNED)];                /* their covariance, packed */
        ts_real sigma;                                          /* and the noise then, um, */
        ts_real filter, smoothing, resonance, inertia;       /* the law's filter, and what was known of the stage, */
        bool oscillated, failed, staged;                     /* an oscillation was found, a stage failed, one was in the model */
        bool begun;                                          /* at the first weights again, since they were kept */
        union {
            ts_recall recall;
            ts_first_gain gain;                              /* until weights were good */
        } watch;
    } kept;                           /* Kalman */
    ts_dynamics_state dynamics;       /* Kalman */
    ts_dynamics found;                /* Kalman: the stage as its oscillation showed it; not known: it is that of the settings */
    ts_sensor_state sensor;
    ts_feedback_state feedback;
    ts_hum_state hum;                 /* Kalman */
    bool hold;
    ts_flags flags;
    ts_counters counters;
} ts_controller;

/* Number of parameters m that the settings make. */
TS_API int ts_parameters(const ts_settings *settings);

/* Checks the settings, keeps the pointer to them, and puts the controller at rest: plays at 0 V, w(0), P(0). Where they are refused,
 * nothing has changed. */
TS_API ts_status ts_controller_init(ts_controller *c, const ts_settings *settings);

/* Back to the state after ts_controller_init. */
TS_API void ts_controller_reset(ts_controller *c);

/* How far from 0 (um) an actuator under `volts` may be: three strokes, and three times the part of the stroke that
 * corresponds to `volts`; at most measurement_limit. Beyond it the sensor is not zeroed, or is that of another axis. */
TS_API ts_real ts_reach(const ts_settings *settings, ts_real volts);

/* Starts with an actuator that rests at the displacement z (um) under `volts`: the next command for z is `volts`.
 * Refused where `volts` are beyond their limits or z is beyond ts_reach; nothing has changed then. */
TS_API ts_status ts_controller_start(ts_controller *c, ts_real volts, ts_real z);

/* New settings, in another place than the present ones, while running, without a jump of the command. Law, terms, thresholds, creep times, stroke, tick and prior stay
 * as they are: TS_BAD_TERMS, and nothing has changed, where one of them differs. */
TS_API ts_status ts_controller_change(ts_controller *c, const ts_settings *settings);

/* Desired displacement z_d (um) and velocity zdot_d (um/s) to the command *volts, within the limits. */
TS_API ts_status ts_controller_command(ts_controller *c, ts_real z_d, ts_real zdot_d, ts_real *volts);

/* The same with more knowledge, NaN where there is none: the acceleration zddot_d (um/s^2; else from the last two rates) and
 * strain_d (um), the displacement that the hysteresis should give so that the stage moves as desired, G^-1 z_d (else from
 * z_d, zdot_d and zddot_d). others: displacement, velocity and acceleration (um, um/s, um/s^2) that are desired of each other
 * axis that TS_COUPLING counts, or, where the motion is known ahead, what G^-1 of this axis makes of them; NULL: they rest at 0. */
TS_API ts_status ts_controller_follow(ts_controller *c, ts_real z_d, ts_real zdot_d, ts_real zddot_d, ts_real strain_d,
                                      const ts_real *others, ts_real *volts);

/* Adapts the weights to a measured displacement z (um). ago: number of commands that were issued after the one of z (0:
 * the last). Measurements come in the order of their commands; any of them may be missing. The first one since
 * init, reset or start, if it comes within TS_HISTORY ticks, is refused beyond ts_reach. One that shows the displacement
 * before the first command, because the sensor is late, is passed over. */
TS_API ts_status ts_controller_adapt(ts_controller *c, ts_real z, int ago);

/* Stops (true) and resumes (false) the adaptation; commands go on. */
TS_API void ts_controller_hold(ts_controller *c, bool hold);

/* For those who read the covariance: after a tick that had much to do it is made in the next one, or here, with the same bits. */
TS_API void ts_controller_complete(ts_controller *c);

/* ---- Repetition ---------------------------------------------------------------------------------------------------- */

/* What is added to the command in a motion that repeats, and the phase of that motion. The controller is another struct: its
 * voltage goes through ts_repetition_volts. A tick: ts_repetition_tick, ts_controller_command, ts_repetition_volts; then
 * ts_repetition_see, and ts_controller_adapt unless `corrects`: meanwhile the controller rests. Each is O(1). */

/* One period of a motion, and sums over it. */
typedef struct {
    const ts_real *wave;              /* um, as many as the period has phases */
    ts_real mean, span;               /* um; peak to peak */
    ts_real power, slopes;            /* um^2: squares of it less its mean, and of half of the difference of both neighbours */
    ts_real cosine, sine;             /* um: products of it with those of its phase */
} ts_shape;

/* A correction that a host has learned; it may be in read-only memory. */
typedef struct {
    ts_shape shape;                   /* of the motion in which it was learned */
    const ts_real *volts;             /* one period in the phase of `wave`, V, without its mean, */
    ts_real level;                    /* and the mean, V */
    ts_real gain;                     /* um/V: displacement by voltage, slowly */
} ts_learned_period;

/* Checked by ts_repetition_init. */
typedef struct {
    int size;                         /* phases of a period, 16..TS_LONGEST_PERIOD: its ticks, but for a tick and 1.5 % */
    ts_real period;                   /* ticks; that of the motion may differ by 1.5 % */
    ts_real change;                   /* ticks in which a correction takes over, 1 or more */
    ts_real share;                    /* 0..1: of the mean error of a period, which the next one takes away */
    ts_real cosine, sine;             /* of 2 pi / size; only beside `learned` */
    ts_real ratio;                    /* 1..10: how many times the learned amplitude that of a motion may be, or the other way round */
    int settles;                      /* ticks from the begin to the end of leaving a correction */
    const ts_learned_period *learned; /* NULL: the caller decides what is added */
} ts_repetition_settings;
#define TS_SHORTEST_PERIOD 16
#define TS_LONGEST_PERIOD 8192

typedef struct {                      /* a voltage of one period, and how much of it */
    const ts_real *volts;             /* the caller's; NULL: none */
    ts_real from, to;                 /* at both ends of a change */
} ts_added;

typedef struct {
    const ts_repetition_settings *settings; /* the caller's */
    ts_real *now, *other;             /* the caller's memory: the period that is recorded, and the one that was */
    /* the motion */
    ts_real pace, step;               /* phases in a tick: of its period, and of this one */
    ts_real part;                     /* phase of the last tick: place + part, part 0..1 */
    int place;
    uint64_t turns;                   /* periods so far */
    ts_real value;                    /* um: desired in the last tick */
    ts_shape shape;                   /* of the period that is repeated, or of the last one; wave NULL: none is known */
    ts_real amplitude, offset;        /* 1, um: the motion is offset + amplitude wave, */
    ts_real drift;                    /* um: and further away in the last period */
    int alike;                        /* periods in a row that are alike */
    ts_real error, own, slope, square; /* sums of this period against the shape: of the difference, um, its products, um^2 */
    ts_real first, sum, squares, low, high, slopes; /* of this period: um, um^2 */
    ts_real turned[2], fundamental[2]; /* cosine and sine of this phase, and the sums of products */
    bool started, whole, begun;       /* there was a tick; the value before is known; this period is whole so far */
    bool triggered, repeats;          /* its phase is that of a trigger; it repeats */
    bool aligned, joined;             /* its shape is the learned one; the learned correction is added */
    /* what is added */
    ts_added added[2];
    ts_real changed;                  /* share of the change, 0..1 */
    ts_real level, goal, climb;       /* V, V, V per tick */
    ts_real errors;                   /* um: sum over the ticks that are counted */
    int counted;
    ts_real kept;                     /* V: level with which the learned correction begins */
    ts_real range;                    /* V: between the limits */
    ts_real last;                     /* V */
    int waits;                        /* ticks until a correction that ends has decayed */
    bool corrects, slewed, saturated; /* a voltage is added; a limit has held the last one */
    bool commanded;                   /* there was a voltage */
    uint64_t limited;                 /* ticks in which a limit has held it */
} ts_repetition;

/* At rest, with memory of 2 * size numbers. False, and no change, where a setting is out of its range. */
TS_API bool ts_repetition_init(ts_repetition *r, const ts_repetition_settings *settings, ts_real *memory);

/* The next tick, with the desired displacement, um; whether a period is complete or it no longer repeats. What is not finite
 * changes nothing. */
TS_API bool ts_repetition_tick(ts_repetition *r, ts_real z_d);

/* The next tick begins a period of the motion, or of the learned one: from the first call on its phase is that of these calls. */
TS_API void ts_repetition_trigger(ts_repetition *r);

/* The motion does not repeat any more. A learned correction is taken back. */
TS_API void ts_repetition_leave(ts_repetition *r);

/* From the next tick on so much of one period of a voltage, V, takes over, smoothly; NULL: nothing, and it has ended after
 * `waits` ticks. False, and no change, where a change from one voltage to another has not ended. */
TS_API bool ts_repetition_become(ts_repetition *r, const ts_real *volts, ts_real scale, int waits);

/* Which of `added` is free; -1: none. */
TS_API int ts_repetition_free(const ts_repetition *r);

/* The level goes to a voltage, V, within so many ticks. */
TS_API void ts_repetition_move(ts_repetition *r, ts_real volts, ts_real ticks);

/* The voltage of this tick, V, of that of the controller, within limits, V, and slew, V per tick. */
TS_API ts_real ts_repetition_volts(ts_repetition *r, ts_real inside, ts_real low, ts_real high, ts_real slew);

/* The error of a tick of this motion, um, and the displacement by voltage, um/V, or 0 where it is not known; false where it is NaN, or no error. */
TS_API bool ts_repetition_see(ts_repetition *r, ts_real error, ts_real gain);

#ifdef __cplusplus
}
#endif
#endif
