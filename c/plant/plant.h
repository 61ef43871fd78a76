/* Simulated actuators, unknown to the controller.
 *
 * ts_plant is a driven piezo stage with a structure of its own (docs/plant.md says every formula and every number);
 * ts_matched is the paper's plant (13), of exactly the controller's structure.
 *
 * Contract
 * - C99, no allocation, no printing, no global state. Each struct is plain data without pointers: copy it, keep
 *   thousands of them, run each in a thread of its own.
 * - The caller supplies the randomness: standard normal numbers. The same numbers give the same result to the bit, in
 *   blocks of any length. `volts` and `velocity` must be finite.
 * - Units: displacement um, voltage V, time s, rates Hz. volts is at the D/A converter, before the amplifier.
 * - Arrays may not overlap. Not promised: any behaviour of a struct that was not initialised.
 */
#ifndef TRUESTROKE_PLANT_H
#define TRUESTROKE_PLANT_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define TS_PLANT_MAX_PLAYS 128
#define TS_PLANT_MAX_CREEP 32
#define TS_MATCHED_MAX_PLAYS 32
#define TS_MATCHED_MAX_DEAD_ZONES 8
#define TS_NEVER UINT64_MAX

/* ---- The realistic plant, in the order of its chain -------------------------------------------------------------- */

typedef struct { /* 0 (or infinite limits) switches an effect off */
    double sample_rate;                 /* ticks per second, Hz */
    int steps_per_tick;                 /* steps of the integration */
    int samples_per_tick;               /* samples that one tick averages; divides steps_per_tick */
    double da_step, da_low, da_high;    /* V */
    double amplifier_gain;              /* stack V per D/A V */
    double amplifier_bandwidth;         /* Hz */
    double stack_low, stack_high;       /* V at the stack */
    double sensitivity;                 /* S, um per stack V */
    double hysteresis;                  /* h, part of S that comes from the plays, 1 */
    int plays;                          /* 1..TS_PLANT_MAX_PLAYS */
    double threshold_scale;             /* rho of the density exp(-r / rho), stack V */
    double threshold_max;               /* R, its end, stack V */
    double threshold_exponent;          /* e: thresholds at the quantiles q^e of that density, 1 */
    double asymmetry;                   /* alpha, 1 */
    double asymmetry_stroke;            /* Y, um */
    double creep;                       /* gamma, 1 per decade of time */
    int creep_operators;                /* 1..TS_PLANT_MAX_CREEP */
    double creep_shortest, creep_longest; /* s */
    double resonance;                   /* Hz */
    double damping;                     /* zeta, 1, below 1 */
    double drift;                       /* A, um */
    double drift_time;                  /* s */
    double noise;                       /* standard deviation of one sample, um */
    double ad_step, ad_low, ad_high;    /* um */
    uint64_t change_tick;               /* first tick of the sudden change, or TS_NEVER */
    double change_gain, change_hysteresis;        /* factors */
    double ageing_gain, ageing_hysteresis;        /* relative change per hour */
} ts_plant_settings;

typedef struct {
    ts_plant_settings settings;
    /* from the settings */
    double lag_decay;                         /* of the amplifier over a step */
    double thresholds[TS_PLANT_MAX_PLAYS];    /* stack V */
    double play_weight;                       /* of each play, um per stack V */
    double creep_rate[TS_PLANT_MAX_CREEP];    /* 1 - exp(-step / tau) */
    double creep_weight;                      /* of each creep operator, 1 */
    double ring[4];                           /* transition of (deflection, velocity / omega) over a step */
    double ring_ratio;                        /* 1 / (omega tau) of the amplifier's tau; 0 without lag */
    double ring_gain;                         /* of the stage for exp(-t / tau); 0 without lag */
    /* state */
    uint64_t tick;
    double linear_now, play_weight_now;       /* weights of this tick, um per stack V */
    double volts;                             /* at the stack, V */
    double play[TS_PLANT_MAX_PLAYS];          /* V */
    double creep[TS_PLANT_MAX_CREEP];         /* um */
    double crept;                             /* their weighted sum, um */
    double position, velocity;                /* of the stage: um, and velocity / omega in um */
} ts_plant;

/* At rest at time 0. The settings are not checked. */
void ts_plant_init(ts_plant *p, const ts_plant_settings *settings);

/* Runs `ticks` ticks. volts, measured, truth: ticks entries each; noise: ticks * samples_per_tick. */
void ts_plant_run(ts_plant *p, const double *volts, const double *noise, double *measured, double *truth, size_t ticks);

/* ---- The matched plant (13) -------------------------------------------------------------------------------------- */

typedef struct {
    int plays, dead_zones;
    double thresholds[TS_MATCHED_MAX_PLAYS];                    /* r, V */
    double a[2][TS_MATCHED_MAX_PLAYS], b[2][TS_MATCHED_MAX_PLAYS]; /* a_p, b_p before and after the change, um/V */
    double rate_scale;                                          /* c_b, s/um */
    double dead_zone_thresholds[TS_MATCHED_MAX_DEAD_ZONES];     /* d, um */
    double dead_zone_weights[TS_MATCHED_MAX_DEAD_ZONES];        /* w_s, 1 */
    double noise;                                               /* standard deviation of one tick, um */
    uint64_t change_tick;                                       /* or TS_NEVER */
} ts_matched_settings;

typedef struct {
    ts_matched_settings settings;
    uint64_t tick;
    double play[TS_MATCHED_MAX_PLAYS]; /* V */
} ts_matched;

void ts_matched_init(ts_matched *m, const ts_matched_settings *settings);

/* Runs `ticks` ticks. velocity: desired velocity of each tick, um/s; noise: one number a tick. */
void ts_matched_run(ts_matched *m, const double *volts, const double *velocity, const double *noise, double *measured,
                    double *truth, size_t ticks);

#ifdef __cplusplus
}
#endif
#endif
