/* The identified model of an actuator as the unit of an FMU, at one sample rate. */
#ifndef TRUESTROKE_FMI_ACTUATOR_H
#define TRUESTROKE_FMI_ACTUATOR_H

#include "truestroke.h"

typedef struct { /* places are those of the weights, -1 where there is none */
    double sample_rate, rate_scale, velocity, fastest, stroke, zero; /* Hz, s/um, um/s, um/s, um, um */
    double volts_low, volts_high;                           /* of the record, V */
    double r[FMU_PLAYS];                                    /* V */
    int a[FMU_PLAYS], b[FMU_PLAYS], lag, offset, asymmetry;
    double creep[FMU_CREEPS + 1]; /* share of a tick that each state follows */

    double low, half;                                           /* V: of the branches */
    int curve[FMU_CURVES + 1];                                  /* 0 convex, 1 concave, 2 sigmoid */
    double curve_at_zero[FMU_CURVES + 1], curve_r[FMU_CURVED + 1]; /* V */
    double cell_r[FMU_LEVELS + 1];                              /* V */
    double cell_low[FMU_CELLS + 1], cell_high[FMU_CELLS + 1], cell_at_zero[FMU_CELLS + 1]; /* V */
    double beta[FMU_DUHEM + 1], branch[FMU_BRANCHES + 1];       /* beta over half of the range; weights, um/V */

    bool staged, delayed;                         /* whether there are dynamics; whether there is a delay or a lag */
    double direct[3], section[FMU_SECTIONS + 1][4]; /* of the dynamics: taps; b0, b1, a1, a2 */
    double last, before, kept;                    /* of the lag */
    double part;                                  /* of a tick: what the delay has beside whole ones */
    double proven, faster[3]; /* s: by which motion lags that is faster than the record; last, before, kept of it */
} fmu_model;

typedef struct { /* a tick, kept until the velocity around it is known */
    double play[FMU_PLAYS], known[FMU_TERMS + 1];
    double further, still; /* um: of the branches; displacement without velocity */
} fmu_sample;

typedef struct {
    double a[FMU_PLAYS], b[FMU_PLAYS], weight[FMU_TERMS + 1]; /* by the parameters */
    double first, volts, creep[FMU_CREEPS + 1];               /* V */
    double curved[FMU_CURVES + 1][FMU_CURVED + 1], levelled[FMU_LEVELS + 1], duhem[2 * FMU_DUHEM + 1], s;
    fmu_sample sample[2 * FMU_LOOK + 1];
    double rest;                                      /* um: the strain of the first tick */
    double faster;                                    /* um: of the lag of motion that is faster than the record */
    double dead[FMU_DEAD + 1], input[2], section[FMU_SECTIONS + 1][2], lag, late[FMU_WHOLE + 2];
    bool fast; /* whether the velocity was beyond that of the record */
} fmu_unit;

extern const fmu_model fmu_settings;

#endif
