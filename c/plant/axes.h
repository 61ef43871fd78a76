/* Two or three simulated stages that disturb each other, read by sensors that may be turned against them.
 *
 * docs/plant.md says every formula. The contract is that of stage.h.
 */
#ifndef TRUESTROKE_AXES_H
#define TRUESTROKE_AXES_H

#include "stage.h"

#ifdef __cplusplus
extern "C" {
#endif

#define TS_AXES_MAX 3

typedef struct { /* row i, column j: what axis i takes of axis j; the diagonals of the first three are not used */
    int axes;                                    /* 2..TS_AXES_MAX */
    double coupling[TS_AXES_MAX][TS_AXES_MAX];   /* um/um: of its displacement, added behind the modes */
    double push[TS_AXES_MAX][TS_AXES_MAX];       /* um/um: the same as a force, which the modes of axis i answer */
    double drag[TS_AXES_MAX][TS_AXES_MAX];       /* s: of its velocity, added behind the modes */
    double frame[TS_AXES_MAX][TS_AXES_MAX];      /* what sensor i reads of the displacement of axis j, 1 */
} ts_axes_settings;

typedef struct {
    ts_axes_settings settings;
    ts_stage stage[TS_AXES_MAX];
    double before[TS_AXES_MAX]; /* um: displacement at the end of the step before the last one */
    double pushed[TS_AXES_MAX]; /* um: force at the end of the last tick */
} ts_axes;

/* At rest at time 0. The stages have the same sample rate, steps and samples of a tick. */
void ts_axes_init(ts_axes *p, const ts_axes_settings *settings, const ts_stage_settings *stages);

/* Runs `ticks` ticks. volts, measured, truth: `axes` entries a tick; noise: samples_per_tick of each axis in turn, a tick. What acts
 * from one axis on another is a step of the integration late. measured and truth are in the frame of the sensors. */
void ts_axes_run(ts_axes *p, const double *volts, const double *noise, double *measured, double *truth, size_t ticks);

#ifdef __cplusplus
}
#endif
#endif
