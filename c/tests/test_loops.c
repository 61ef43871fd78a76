/* The loop over ticks against a controller and an actuator whose answers are known, and the filter in exact numbers. */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#include "loops.h"

enum { TICKS = 6 };
static int passed, failed;

static void check(bool ok, const char *what)
{
    if (ok) { passed++; return; }
    failed++;
    printf("FAILED: %s\n", what);
}

/* Commands 2 z_d; its flags are all ones after a command of an odd tick, and after a measurement above 5 it is rejected. */
typedef struct { int commands, adaptations; unsigned flags; double last; } controller;

static double command(void *self, const double motion[4], const double *others)
{
    controller *c = self;
    if (others) return motion[0] + 10 * others[0] + 100 * others[1] + 1000 * others[2];
    c->flags = c->commands++ % 2 ? 0x3f : 0;
    return 2 * motion[0] + motion[1] + (motion[2] == motion[2] ? 100 * motion[2] + 1000 * motion[3] : 0);
}

static void adapt(void *self, double z)
{
    controller *c = self;
    c->adaptations++;
    c->last = z;
    c->flags = z > 5 ? 4 : 16;
}

static unsigned flags(void *self) { return ((controller *)self)->flags; }
static double innovation(void *self) { return -((controller *)self)->last; }

/* Measures the voltage and both its noise numbers; the truth is the velocity. */
static void exchange(void *self, double volts, double velocity, const double *noise, double *measured, double *truth)
{
    ++*(int *)self;
    *measured = volts + noise[0] + noise[1];
    *truth = velocity;
}

static void test_loop(void)
{
    static const double z_d[TICKS] = {0, 1, 2, 3, 4, 5}, zdot_d[TICKS] = {1, 1, 1, 1, 1, 1};
    static const double noise[2 * TICKS] = {0.5, 0.25, 0, 0, 0, 0, 0, 0, 0, 0, 0, -1};
    double volts[TICKS], measured[TICKS], truth[TICKS], found[TICKS];
    uint8_t bits[TICKS];
    controller c = {0};
    int exchanges = 0;
    ts_loop_controller law = {&c, command, adapt, flags, innovation};
    ts_loop_actuator plant = {&exchanges, 2, exchange};
    ts_loop_channels channels = {z_d, zdot_d, NULL, NULL, noise, volts, measured, truth, found, bits};
    ts_loop_run(&law, &plant, &channels, 0);
    check(c.commands == 0 && exchanges == 0, "no ticks, nothing happens");
    ts_loop_run(&law, &plant, &channels, TICKS);
    check(c.commands == TICKS && c.adaptations == TICKS && exchanges == TICKS, "each tick once");
    static const double expected[TICKS] = {1.75, 3, 5, 7, 9, 10};
    check(memcmp(measured, expected, sizeof expected) == 0, "volts and the noise of each tick reach the actuator");
    check(truth[TICKS - 1] == 1, "so does the velocity");
    check(bits[0] == 16 && bits[1] == (0x3f & ~4), "rejected and changed are adapt's, the others command's");
    check(bits[3] == (0x3f & ~16) && bits[4] == 4, "also where a measurement is rejected");
    channels.zddot_d = zdot_d;
    channels.strain_d = z_d;
    ts_loop_run(&law, &plant, &channels, 2);
    check(volts[1] == 1103, "acceleration and strain reach the controller where they are known");
    check(found[2] == -5 && isnan(found[3]), "the innovation of a rejected measurement is NaN");
}

/* Two axes: each measures its own voltage and a tenth of the other's, behind sensors that are exchanged. */
static void exchange_axes(void *self, const double *volts, const double *noise, double *measured, double *truth)
{
    ++*(int *)self;
    for (int i = 0; i < 2; i++) {
        truth[1 - i] = volts[i];
        measured[1 - i] = volts[i] + 0.125 * volts[1 - i] + noise[i];
    }
}

static void test_axes(void)
{
    enum { N = 2 };
    static const double motion[6 * N] = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}; /* z_d, zdot_d, zddot_d of each axis */
    static const double strain[2 * N] = {0}, others[6 * N] = {1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1};
    static const double to_axes[4] = {0, 1, 1, 0}, noise[2 * N] = {0, 0, 0.5, 0.25};
    double volts[2 * N], measured[2 * N], truth[2 * N], found[2 * N];
    uint8_t bits[2 * N];
    controller c[2] = {{0}, {0}};
    int exchanges = 0;
    ts_loop_controller laws[2] = {{&c[0], command, adapt, flags, innovation}, {&c[1], command, adapt, flags, innovation}};
    ts_loop_axes plant = {&exchanges, 2, 2, exchange_axes};
    ts_loop_axes_channels ch = {motion, strain, others, to_axes, noise, volts, measured, truth, found, bits};
    ts_loop_run_axes(laws, &plant, &ch, N);
    static const double expected[2 * N] = {1 + 10, 4 + 100, 7 + 1000, 10 + 1110};
    check(memcmp(volts, expected, sizeof volts) == 0, "each controller has its own motion, and that of the other axis");
    check(measured[1] == 11 + 13 && measured[0] == 104 + 1.375, "the actuator has the voltages of one tick");
    check(c[0].last == 1007 + 140 + 0.5 && c[1].last == 1120 + 125.875 + 0.25, "each adapts to its axis, not to its sensor");
    check(exchanges == N && c[0].adaptations == N && truth[3] == 1007, "each tick once");
    check(isnan(found[0]) && bits[0] == 4, "a rejected measurement has no innovation");
}

static void test_first_order(void)
{
    static const double decay[2] = {0, 0.5}, u[4] = {1, 0, 0, 2}; /* decay = i / 2 */
    double x[6] = {4, 2};                                         /* 4 + 2i -> -1 + 2i + 1 -> -1 + 0i + 2i */
    ts_first_order(decay, u, x, 2);
    check(x[2] == 0 && x[3] == 2 && x[4] == -1 && x[5] == 2, "x[k + 1] = decay x[k] + u[k], complex");
}

int main(void)
{
    test_loop();
    test_axes();
    test_first_order();
    printf("loops: %d passed, %d failed\n", passed, failed);
    return failed != 0;
}
