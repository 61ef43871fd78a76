/* Every variant of the kernel that this processor runs gives the bits of plain C99, and none of them allocates. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "dispatch.h"

/* The linker sends every allocation here (--wrap). */
static int allocations;
void *__real_malloc(size_t size);
void *__real_calloc(size_t count, size_t size);
void *__real_realloc(void *old, size_t size);
void *__wrap_malloc(size_t size);
void *__wrap_calloc(size_t count, size_t size);
void *__wrap_realloc(void *old, size_t size);
void *__wrap_malloc(size_t size) { allocations++; return __real_malloc(size); }
void *__wrap_calloc(size_t count, size_t size) { allocations++; return __real_calloc(count, size); }
void *__wrap_realloc(void *old, size_t size) { allocations++; return __real_realloc(old, size); }

static uint32_t seed;
static ts_real uniform(double low, double high)
{
    seed = seed * 1664525u + 1013904223u;
    return (ts_real)(low + (high - low) * (seed >> 8) / 16777216.0);
}

static ts_settings settings(int plays, bool kalman)
{
    ts_settings s = {.plays = plays, .dead_zones = 3, .dead_zone_thresholds = {0, 12, 20},
                     .dead_zone_weights = {1, (ts_real)0.05, (ts_real)-0.03}, .rate_scale = (ts_real)0.007, .stroke = 30,
                     .forgetting = (ts_real)0.999, .regularization = (ts_real)1e-3, .covariance_limit = (ts_real)1e6,
                     .slope_min = 2, .slope_max = 20, .voltage_min = (ts_real)-0.6, .voltage_max = (ts_real)3.6,
                     .slew = (ts_real)0.5, .measurement_limit = 300, .velocity_limit = 1500,
                     .smoothing = (ts_real)0.5, .trim = (ts_real)0.001, .first_noise = (ts_real)0.03};
    for (int i = 0; i < plays; i++) {
        s.thresholds[i] = (ts_real)(1.8 * i / plays);
        s.rate_dependent[i] = !kalman || i % 3 == 0;
    }
    s.initial_weights[0] = 8;
    if (!kalman) return s;
    s.law = TS_LAW_KALMAN;
    s.terms[TS_CREEP] = 2, s.terms[TS_LAG] = 1, s.terms[TS_OFFSET] = 1, s.terms[TS_ASYMMETRY] = 2, s.terms[TS_DUHEM] = 2;
    s.creep[0] = (ts_real)0.15, s.creep[1] = (ts_real)0.0017, s.duhem[0] = (ts_real)4.2, s.duhem[1] = (ts_real)1.05;
    s.kalman = (ts_kalman_settings){
        .filter = (ts_real)0.6, .noise_rate = (ts_real)1e-3, .ringing_rate = (ts_real)0.1,
        .model_error = (ts_real)6e-3, .prior_return = (ts_real)1e-6, .change_threshold = 12,
        .change_rate = (ts_real)0.2, .refractory = 10, .change_gain = (ts_real)0.15,
        .change_hysteresis = (ts_real)0.3, .change_share = (ts_real)2e-3, .outlier = 12, .outliers = 3};
    int m = ts_parameters(&s);
    for (int i = 0; i < m; i++) s.prior[TS_PACKED(i) + i] = i ? (ts_real)0.5 : 9;
    return s;
}

/* Motion, noise, lost and late measurements, a jump of gain, limits: the state behind all of it. */
static void drive(ts_controller *c, const ts_settings *s)
{
    ts_real play = 0, volts = 0, gap = (ts_real)0.3;
    seed = 7;
    memset(c, 0, sizeof *c);
    ts_controller_init(c, s);
    ts_controller_start(c, (ts_real)1.2, 15);
    for (int k = 0; k < 3000; k++) {
        ts_real z_d = uniform(0, 30), gain = k < 1500 ? 1 : (ts_real)0.8;
        ts_controller_command(c, k % 500 < 20 ? 60 : (z_d + 29 * 15) / 30, uniform(-400, 400), &volts);
        play = volts - gap > play ? volts - gap : volts + gap < play ? volts + gap : play;
        if (k % 11) ts_controller_adapt(c, gain * (8 * volts + 3 * play) + uniform(-0.1, 0.1), k % 7 == 0);
    }
}

/* A motion that repeats, with a table that is added. */
static ts_real repeat(ts_repetition *r, const ts_real *table)
{
    static const ts_repetition_settings s = {.size = 40, .period = 40, .change = 15, .share = (ts_real)0.3};
    static ts_real memory[80];
    ts_real sum = 0;
    seed = 9;
    memset(r, 0, sizeof *r);
    ts_repetition_init(r, &s, memory);
    for (int k = 0; k < 2000; k++) {
        int at = k % 40 < 20 ? k % 40 : 40 - k % 40;
        ts_repetition_tick(r, (ts_real)at / (k < 1500 ? 3 : 4));
        if (r->repeats && !r->corrects) ts_repetition_become(r, table, 1, 0);
        sum += ts_repetition_volts(r, uniform(0, 3), 0, 3, 1);
        ts_repetition_see(r, uniform(-1, 1), 8);
    }
    return sum;
}

int main(void)
{
    static const int PLAYS[] = {1, 3, 4, 8, 13, 16, 24, 32};
    static ts_controller plain, other;
    int failed = 0, compared = 0;
    for (int p = 0; p < 8; p++)
        for (int kalman = 0; kalman < 2; kalman++) {
            ts_settings s = settings(PLAYS[p], kalman);
            ts_variant_use("plain");
            drive(&plain, &s);
            failed += plain.counters.adaptations < 1500;
            for (int v = 1; ts_variant_name(v); v++, compared++) {
                ts_variant_use(ts_variant_name(v));
                allocations = 0;
                drive(&other, &s);
                bool same = memcmp(&plain, &other, sizeof plain) == 0;
                if (same && allocations == 0) continue;
                printf("FAILED: %s, %d plays, law %d: %s, %d allocations\n", ts_variant_in_use(), PLAYS[p], kalman,
                       same ? "the same bits" : "other bits than plain C99", allocations);
                failed++;
            }
        }
    static ts_real table[40] = {0, (ts_real)0.1, (ts_real)0.3, (ts_real)0.2};
    static ts_repetition repeated, again;
    ts_variant_use("plain");
    ts_real sum = repeat(&repeated, table);
    failed += !repeated.corrects;
    for (int v = 1; ts_variant_name(v); v++, compared++) {
        ts_variant_use(ts_variant_name(v));
        ts_real other_sum = repeat(&again, table);
        failed += other_sum < sum || other_sum > sum || memcmp(&repeated, &again, sizeof again) != 0;
    }
    void *volatile counted = malloc(1); /* the counter counts */
    free(counted);
    failed += allocations == 0;
    printf("variants (%s): %d runs with the bits of plain C99 and without an allocation, %d failed\n",
           sizeof(ts_real) == 8 ? "double" : "float", compared - failed, failed);
    return failed != 0;
}
