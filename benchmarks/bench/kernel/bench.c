/* What the kernel costs on this machine, one JSON object a line: ./bench [calls]
 *
 * "ns" is the best mean of a window of calls: what the code takes where nothing disturbs it. "median_ns", "p999_ns" and
 * "worst_ns" are of single calls, less the median of an empty measurement; they hold what the operating system adds.
 */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "dispatch.h"
#include "probe.h"

enum { WINDOW = 512, WAVE = 4096 };
static const char *const NUMBER = sizeof(ts_real) == 8 ? "double" : "float";
static double *times;
static int calls = 1000000;

typedef struct {
    ts_controller controller;
    ts_settings settings;
    ts_rls rls;
    int m, ticks;
    ts_real w[TS_PADDED(TS_MAX_PARAMETERS)], u[64][TS_PADDED(TS_MAX_PARAMETERS)];
    ts_real z_d[WAVE], zdot_d[WAVE], noise[WAVE], play;
} bench;

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

static double uniform(void)
{
    static unsigned seed = 1;
    seed = seed * 1664525u + 1013904223u;
    return (seed >> 8) / 16777216.0;
}

static int ascending(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void nothing(bench *b) { (void)b; }

static void update(bench *b)
{
    int k = b->ticks++;
    ts_rls_update(&b->rls, b->w, b->u[k % 64], (ts_real)1e-3, (ts_real)0.9999, (ts_real)1e6, b->m);
}

static void limit(bench *b) { ts_probe_rls(&b->rls, b->w, b->u[b->ticks++ % 64], b->m); }

/* A tick in the loop with a stack of one play and 20 nm of noise, which takes some nanoseconds of its own. */
static void tick(bench *b)
{
    int k = b->ticks++ % WAVE;
    ts_real volts, gap = (ts_real)0.45;
    ts_controller_command(&b->controller, b->z_d[k], b->zdot_d[k], &volts);
    b->play = volts - gap > b->play ? volts - gap : volts + gap < b->play ? volts + gap : b->play;
    ts_controller_adapt(&b->controller, 9 * volts + 4 * b->play + b->noise[k], 0);
}

static void command(bench *b)
{
    int k = b->ticks++ % WAVE;
    ts_real volts;
    ts_controller_command(&b->controller, b->z_d[k], b->zdot_d[k], &volts);
}

static void measure(const char *what, const char *law, int plays, void (*call)(bench *), bench *b)
{
    double best = INFINITY, empty = 0;
    for (int k = 0; k < 2000 + calls; k += WINDOW) { /* the first ones warm up */
        double start = now();
        for (int i = 0; i < WINDOW; i++) call(b);
        double mean = (now() - start) / WINDOW;
        if (k >= 2000 && mean < best) best = mean;
    }
    for (int pass = 0; pass < 2; pass++) {
        for (int k = 0; k < calls; k++) {
            double start = now();
            (pass ? call : nothing)(b);
            times[k] = now() - start;
        }
        qsort(times, (size_t)calls, sizeof *times, ascending);
        if (!pass) empty = times[calls / 2];
    }
    printf("{\"what\": \"%s\", \"law\": \"%s\", \"plays\": %d, \"parameters\": %d, \"number\": \"%s\", \"variant\": \"%s\", "
           "\"ns\": %.1f, \"median_ns\": %.0f, \"p999_ns\": %.0f, \"worst_ns\": %.0f, \"calls\": %d}\n",
           what, law, plays, b->m, NUMBER, ts_variant_in_use(), best, times[calls / 2] - empty,
           times[(int)(0.999 * calls)] - empty, times[calls - 1] - empty, calls);
    fflush(stdout);
}

/* Settings as AdaptiveController.paper() and the default make them for a stroke of 30 um. */
static ts_settings settings(int plays, bool paper)
{
    ts_settings s = {.plays = plays, .dead_zones = 1, .dead_zone_weights = {1}, .rate_scale = (ts_real)0.007,
                     .stroke = 30, .forgetting = (ts_real)0.9999, .regularization = (ts_real)1e-3,
                     .covariance_limit = (ts_real)1e6, .slope_min = (ts_real)0.36, .slope_max = (ts_real)1e9,
                     .voltage_min = (ts_real)-0.6, .voltage_max = (ts_real)3.6, .slew = (ts_real)1e9,
                     .measurement_limit = 300};
    for (int i = 0; i < plays; i++) {
        s.thresholds[i] = (ts_real)(i * 1.8 / plays);
        s.rate_dependent[i] = paper || i < 5;
    }
    s.initial_weights[0] = 8;
    if (paper) return s;
    s.law = TS_LAW_KALMAN;
    s.terms[TS_CREEP] = 4, s.terms[TS_LAG] = 1, s.terms[TS_OFFSET] = 1, s.terms[TS_ASYMMETRY] = 2;
    s.terms[TS_DUHEM] = 2, s.duhem[0] = (ts_real)4.2, s.duhem[1] = (ts_real)1.05;
    for (int i = 0; i < 4; i++) s.creep[i] = (ts_real)(0.15 * pow(0.1, i));
    s.slope_min = 3, s.slope_max = 28, s.velocity_limit = 1500, s.slew = (ts_real)0.25, s.smoothing = (ts_real)0.5;
    s.first_noise = (ts_real)0.03;
    s.kalman = (ts_kalman_settings){
        .filter = (ts_real)0.6, .noise_rate = (ts_real)1e-3, .ringing_rate = (ts_real)0.1,
        .model_error = (ts_real)6e-3, .prior_return = (ts_real)1e-6, .change_threshold = 12,
        .change_rate = (ts_real)0.2, .refractory = 10, .change_gain = (ts_real)0.15,
        .change_hysteresis = (ts_real)0.3, .change_share = (ts_real)2e-3, .outlier = 12, .outliers = 3};
    int m = ts_parameters(&s);
    for (int i = 0; i < m; i++) s.prior[TS_PACKED(i) + i] = i == 0 ? 9 : i < m - 2 ? (ts_real)0.2 : (ts_real)0.007;
    return s;
}

/* Two sines; the regressors of the update alone are random. */
static void prepare(bench *b, int plays, bool paper)
{
    memset(b, 0, sizeof *b);
    b->settings = settings(plays, paper); /* the controller points to them */
    if (ts_controller_init(&b->controller, &b->settings) != TS_OK) exit(1);
    b->m = ts_parameters(&b->settings);
    ts_rls_init(&b->rls, (ts_real)1e-3, b->m);
    double phase = 6.283185307179586 / WAVE;
    for (int k = 0; k < WAVE; k++) {
        b->z_d[k] = (ts_real)(15 - 8 * cos(16 * phase * k) - 6 * cos(41 * phase * k));
        b->zdot_d[k] = (ts_real)(2000 * phase * (128 * sin(16 * phase * k) + 246 * sin(41 * phase * k)));
        b->noise[k] = (ts_real)(0.07 * (uniform() - 0.5));
    }
    for (int k = 0; k < 64; k++)
        for (int i = 0; i < b->m; i++) b->u[k][i] = (ts_real)uniform();
}

int main(int argc, char **argv)
{
    static bench b;
    static const int PLAYS[] = {4, 8, 16, 24, 32};
    if (argc > 1) calls = atoi(argv[1]);
    times = malloc(sizeof *times * (size_t)calls);
    if (calls < 1000 || !times) return 1;
    for (int v = 0; ts_variant_name(v); v++) {
        bool fastest = ts_variant_name(v + 1) == NULL;
        ts_variant_use(ts_variant_name(v));
        for (int p = 0; p < 5; p++) {
            if (!fastest && p != 1) continue; /* all sizes of the one in use, eight plays of the others */
            prepare(&b, PLAYS[p], true);
            measure("update", "rls", PLAYS[p], update, &b);
            if (fastest) measure("limit", "rls", PLAYS[p], limit, &b);
            prepare(&b, PLAYS[p], true);
            measure("tick", "paper", PLAYS[p], tick, &b);
            measure("command", "paper", PLAYS[p], command, &b);
            prepare(&b, PLAYS[p], false);
            measure("tick", "default", PLAYS[p], tick, &b);
        }
        if (fastest) continue;
        prepare(&b, 24, false);
        measure("tick", "default", 24, tick, &b);
    }
    free(times);
    return 0;
}
