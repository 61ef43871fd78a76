/* Loops over ticks, for simulation: controller against actuator, and the filter behind the random waves.
 *
 * Contract
 * - C99, no allocation, no printing, no global state; the caller owns everything. A loop uses its arguments only, so
 *   each thread may run one.
 * - Units: displacement um, velocity um/s, voltage V at the D/A converter. Arrays may not overlap.
 */
#ifndef TRUESTROKE_LOOPS_H
#define TRUESTROKE_LOOPS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A controller: the two calls of the Python protocol. `flags` are the bits of the last tick: 1 saturated, 2 projected,
 * 4 rejected, 8 held, 16 changed, 32 slewed, 64 oscillating, 128 restored. */
typedef struct {
    void *self;
    /* z_d, zdot_d, zddot_d, strain_d, NaN: not known; of each other axis the first three, or NULL */
    double (*command)(void *self, const double motion[4], const double *others);
    void (*adapt)(void *self, double z);
    unsigned (*flags)(void *self);
    double (*innovation)(void *self);
} ts_loop_controller;

/* A simulated actuator: holds `volts` for a tick. velocity: the desired one, which the matched plant knows; noise:
 * `noise_per_tick` standard normal numbers. */
typedef struct {
    void *self;
    size_t noise_per_tick;
    void (*exchange)(void *self, double volts, double velocity, const double *noise, double *measured, double *truth);
} ts_loop_actuator;

typedef struct {
    const double *z_d, *zdot_d;                  /* one entry a tick */
    const double *zddot_d, *strain_d;            /* the same, or NULL: not known */
    const double *noise;                         /* noise_per_tick entries a tick */
    double *volts, *measured, *truth, *innovation; /* one entry a tick; innovation is NaN where z was rejected */
    uint8_t *flags;
} ts_loop_channels;

/* `ticks` ticks: command, exchange, adapt. Continues from the present state of both. */
void ts_loop_run(const ts_loop_controller *c, const ts_loop_actuator *a, const ts_loop_channels *ch, size_t ticks);

#define TS_LOOP_MAX_AXES 3

/* A simulated actuator of several axes; noise: `noise_per_tick` numbers of all of them. */
typedef struct {
    void *self;
    size_t axes, noise_per_tick;
    void (*exchange)(void *self, const double *volts, const double *noise, double *measured, double *truth);
} ts_loop_axes;

typedef struct { /* each entry of a tick is followed by the same of the next axis */
    const double *motion;                        /* z_d, zdot_d, zddot_d of each axis in its own frame */
    const double *strain_d;                      /* of each axis; NaN: not known */
    const double *others;                        /* of each axis, 3 for each other one: what its controller takes of them */
    const double *to_axes;                       /* axes * axes, row by row: of what the sensors read, the displacement of each axis */
    const double *noise;                         /* noise_per_tick entries a tick */
    double *volts, *measured, *truth, *innovation; /* measured and truth as the sensors read them */
    uint8_t *flags;
} ts_loop_axes_channels;

/* The same with a controller for each axis. */
void ts_loop_run_axes(const ts_loop_controller *c, const ts_loop_axes *a, const ts_loop_axes_channels *ch, size_t ticks);

/* x[k + 1] = decay x[k] + u[k] from a given x[0]: the states of a first-order filter, all complex: pairs of real and
 * imaginary part. u: `ticks` pairs; x: ticks + 1 pairs. */
void ts_first_order(const double decay[2], const double *u, double *x, size_t ticks);

#ifdef __cplusplus
}
#endif
#endif
