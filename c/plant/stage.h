/* A simulated stage for fast motion: hysteresis of three structures, up to three modes, dead time, loads and hum.
 *
 * docs/plant.md says every formula. The contract is that of plant.h: C99, no allocation, no printing, no global state,
 * plain data without pointers, normal numbers from the caller, the same bits in blocks of any length.
 */
#ifndef TRUESTROKE_STAGE_H
#define TRUESTROKE_STAGE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define TS_STAGE_MAX_MODES 3
#define TS_STAGE_MAX_PLAYS 64
#define TS_STAGE_MAX_CREEP 8
#define TS_STAGE_MAX_STEPS 64   /* of the integration, in a tick */
#define TS_STAGE_MAX_DELAY 20   /* ticks */
#define TS_STAGE_MAX_TURNS 128  /* turning points of the voltage that the Preisach operator remembers */
#define TS_STAGE_PAST (TS_STAGE_MAX_DELAY * TS_STAGE_MAX_STEPS + 4)

enum { TS_STAGE_PLAYS, TS_STAGE_PREISACH, TS_STAGE_BOUC_WEN };

typedef struct { /* 0 switches an effect off; x is the voltage over volts_high */
    double sample_rate;                 /* ticks per second, Hz */
    int steps_per_tick;                 /* a multiple of 2 samples_per_tick, up to TS_STAGE_MAX_STEPS */
    int samples_per_tick;               /* samples that one tick averages, in the middle of equal parts of it */
    double volts_low, volts_high;       /* of the D/A converter, V; volts_low <= 0 < volts_high */
    double dead_time;                   /* s, up to TS_STAGE_MAX_DELAY ticks */
    double amplifier_bandwidth;         /* Hz */
    double stroke;                      /* height of the loop over x = 0..1, um */
    int hysteresis;                     /* TS_STAGE_PLAYS, ... */
    double loop_width;                  /* greatest distance of the branches of that loop over its height, 1 */
    int plays;                          /* 1..TS_STAGE_MAX_PLAYS */
    double threshold_max;               /* R of the plays, in x */
    double threshold_exponent;          /* e: r_i = R ((i + 1/2) / plays)^e */
    double envelope;                    /* a: rising plays follow x - a x^2, falling ones x + a x^2 */
    double preisach_scale;              /* rho of the density exp(-(up - down) / rho) (1 + k1 s + k2 s^2) */
    double preisach_tilt;               /* k1; s = (up + down) / 2 - 1/2 */
    double preisach_curvature;          /* k2 */
    double bouc_wen_beta, bouc_wen_gamma, bouc_wen_exponent; /* beta, gamma, n */
    double creep;                       /* gamma, 1 per decade of time */
    int creep_operators;                /* 1..TS_STAGE_MAX_CREEP */
    double creep_shortest, creep_longest; /* s */
    int modes;                          /* 1..TS_STAGE_MAX_MODES */
    double resonances[TS_STAGE_MAX_MODES]; /* undamped, Hz */
    double dampings[TS_STAGE_MAX_MODES];   /* zeta, 1, below 1 */
    double shares[TS_STAGE_MAX_MODES];     /* of the static displacement; their sum is 1 */
    uint64_t resonance_change_tick;     /* first tick at which the resonances are ... */
    double resonance_change;            /* ... times this factor, 1 */
    double resonance_drift;             /* relative change of the resonances per minute, linear in time */
    double load;                        /* um: its static displacement */
    double load_frequency;              /* Hz; 0 is a constant load */
    uint64_t load_tick;                 /* at which it begins */
    int load_on_stage;                  /* 1: a force, which the modes answer; 0: a displacement behind them */
    double hum, hum_frequency;          /* amplitude of the true displacement, um; Hz */
    double sensor_bandwidth;            /* Hz */
    double sensor_delay;                /* s, up to TS_STAGE_MAX_DELAY ticks */
    double noise;                       /* standard deviation of one sample, um */
} ts_stage_settings;

typedef struct { /* a part of a step of the integration: what follows from its length */
    double lag;                              /* decay of the amplifier's lag */
    double creep_rate[TS_STAGE_MAX_CREEP];   /* 1 - exp(-length / tau) */
    double ring[TS_STAGE_MAX_MODES][4];      /* transition of (um, um/s) of each mode */
} ts_stage_piece;

typedef struct { /* the operator of x, of any height and width */
    double play[TS_STAGE_MAX_PLAYS];
    double turn[TS_STAGE_MAX_TURNS];     /* turning points of x, the lowest first, then high and low by turns */
    double at_turn[TS_STAGE_MAX_TURNS];  /* the operator there */
    int turns;
    double x;                            /* of the last step */
    double q;                            /* of Bouc-Wen */
} ts_stage_memory;

typedef struct {
    ts_stage_settings settings;
    /* from the settings */
    double threshold[TS_STAGE_MAX_PLAYS];
    double linear, hysteretic, offset;   /* um: strain = linear x + hysteretic P[x] - offset */
    double least_slope;                  /* of the loop over x = 0..1, in strokes; not above 0: loop_width cannot be */
    double creep_weight;                 /* of each creep operator, 1 */
    int late_ticks, late_steps;          /* dead time: whole ticks, whole steps of the rest, ... */
    double late_part;                    /* ... and the rest of a step, below 1 */
    ts_stage_piece step, before, after;  /* a whole step; a step before and after the voltage changes within it */
    double omega[TS_STAGE_MAX_MODES];    /* of now, 1/s */
    double forced[TS_STAGE_MAX_MODES];   /* gain of each mode for exp(-t / tau) of the amplifier; 0 without lag */
    double factor;                       /* of the resonances now */
    double sensor[3];                    /* of the sensor's lag over a step: its past, last and new displacement */
    int sensor_base;                     /* steps ago of the newest of the four that give the delayed displacement */
    double sensor_weight[4];
    /* state */
    uint64_t tick;
    double held[TS_STAGE_MAX_DELAY + 2]; /* V, of the last ticks */
    double volts;                        /* behind the amplifier's lag */
    ts_stage_memory memory;
    double strain;                       /* um */
    double creep[TS_STAGE_MAX_CREEP], crept; /* um */
    double position[TS_STAGE_MAX_MODES]; /* um, without its share */
    double velocity[TS_STAGE_MAX_MODES]; /* um/s */
    double displaced;                    /* true displacement at the end of the last step, um */
    double past[TS_STAGE_PAST];          /* displacement behind the sensor's lag at the ends of the last steps, um */
    int newest;                          /* of them */
} ts_stage;

/* At rest at time 0. The settings are not checked; see `least_slope`. */
void ts_stage_init(ts_stage *p, const ts_stage_settings *settings);

/* A tick in parts, for stages that act on each other: `steps_per_tick` steps between begin and end. */
typedef struct {
    double old, target;       /* V at the amplifier, before and after the voltage changes within the tick */
    double pushed;            /* um: force on the stage at the end of the last step */
    double z_sum, measured_sum;
    const double *noise;
} ts_stage_tick;

void ts_stage_begin(ts_stage *p, ts_stage_tick *t, double volts, double pushed, const double *noise);

/* Step i; at its end the modes are pushed by the force `pushes` (um) and `behind` (um) is added to what they give. */
void ts_stage_step(ts_stage *p, ts_stage_tick *t, int i, double pushes, double behind);

void ts_stage_end(ts_stage *p, const ts_stage_tick *t, double *measured, double *truth);

/* Of the settings, um, so many seconds after the tick began. */
double ts_stage_load(const ts_stage *p, double seconds);

/* Runs `ticks` ticks. volts, measured, truth: ticks entries each; load: that of each tick, um, beside that of the
 * settings, or NULL; noise: ticks * samples_per_tick. */
void ts_stage_run(ts_stage *p, const double *volts, const double *load, const double *noise, double *measured,
                  double *truth, size_t ticks);

#ifdef __cplusplus
}
#endif
#endif
