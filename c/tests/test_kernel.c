/* Tests of the kernel alone: vectors from exact fractions (vectors.py), the algebra of the interface, and faults. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "truestroke.h"
#include "vectors.h"

static int passed, failed;
static const double EPS = sizeof(ts_real) == 8 ? 1e-12 : 2e-4; /* relative; float loses digits in 25 RLS updates */

static void check(bool ok, const char *what)
{
    if (ok) { passed++; return; }
    failed++;
    printf("FAILED: %s\n", what);
}

static bool near(double value, double truth, double scale)
{
    return fabs(value - truth) <= EPS * scale;
}

static void copy(ts_real *target, const double *source, int n)
{
    for (int i = 0; i < n; i++) target[i] = (ts_real)source[i];
}

/* A small generator of its own, so that every platform runs the same test. */
static uint32_t seed = 1;
static double uniform(double low, double high)
{
    seed = seed * 1664525u + 1013904223u;
    return low + (high - low) * (seed >> 8) / 16777216.0;
}

static ts_settings settings(void)
{
    ts_settings s = {.plays = 8, .dead_zones = 1, .dead_zone_weights = {1}, .rate_scale = (ts_real)0.007,
                     .forgetting = (ts_real)0.9999, .regularization = (ts_real)1e-3, .covariance_limit = (ts_real)1e9,
                     .slope_min = (ts_real)0.36, .voltage_min = (ts_real)-0.6, .voltage_max = (ts_real)3.6};
    for (int i = 0; i < s.plays; i++) s.thresholds[i] = (ts_real)(i * 0.225);
    s.initial_weights[0] = 5;
    return s;
}

/* ---- Vectors ------------------------------------------------------------------------------------------------------- */

static void test_play_bank(void)
{
    ts_real r[N], y[N] = {0};
    copy(r, R, N);
    bool ok = true;
    for (int k = 0; k < TICKS; k++) {
        ts_play_bank((ts_real)X[k], r, y, N);
        for (int i = 0; i < N; i++) ok &= near(y[i], PLAYS[k * N + i], 4);
    }
    check(ok, "play bank (1)");
}

static void test_inverse(void)
{
    ts_real r[N], y[N] = {0}, s[N];
    copy(r, R, N);
    bool ok = true;
    for (int k = 0; k < TICKS; k++) {
        copy(s, SLOPES + k * N, N);
        ts_real x = ts_play_inverse((ts_real)TARGETS[k], s, r, y, N);
        ok &= near(x, VOLTS[k], 50);
        ts_play_bank((ts_real)VOLTS[k], r, y, N);
    }
    check(ok, "inverse (10), (12) with weights redrawn every tick");
}

static void test_rls(void)
{
    ts_real w[M] = {5}, S[M * M] = {0}, f[M], u[M];
    for (int i = 0; i < M; i++) S[i * M + i] = (ts_real)sqrt(1000);
    bool ok = true;
    for (int k = 0; k < UPDATES; k++) {
        copy(u, U + k * M, M);
        ok &= ts_rls_update(w, S, f, u, (ts_real)E[k], (ts_real)LAMBDA, (ts_real)1e9, M);
        double trace = 0;
        for (int i = 0; i < M; i++) {
            for (int j = 0; j < M; j++) trace += (double)S[i * M + j] * S[i * M + j];
            ok &= near(w[i], W[k * M + i], 50);
        }
        ok &= near(trace, TRACE[k], 40 * TRACE[0]);
    }
    check(ok, "recursive least squares (23)");
}

static void test_dead_zones(void)
{
    ts_real d[DEAD], w[DEAD];
    copy(d, D, DEAD);
    copy(w, W_S, DEAD);
    bool ok = true;
    for (int k = 0; k < POINTS; k++) ok &= near(ts_dead_zones((ts_real)Z[k], d, w, DEAD), Y_S[k], 30);
    check(ok, "dead zones (4), (5)");
}

/* ---- Algebra of the interface ---------------------------------------------------------------------------------------- */

/* One tick against a plant with play: two branches of 9 and 4 um/V. */
static ts_real tick(ts_controller *c, ts_real plant[2], int k)
{
    static const ts_real r[2] = {0, (ts_real)(2 * 0.225)};
    double phase = 0.01 * k * (1 + 0.2 * sin(0.003 * k));
    ts_real volts = 0;
    ts_controller_command(c, (ts_real)(15 - 14 * cos(phase)), (ts_real)(280 * sin(phase)), &volts);
    ts_play_bank(volts, r, plant, 2);
    ts_real z = 9 * plant[0] + 4 * plant[1];
    ts_controller_adapt(c, z, 0);
    return z - (ts_real)(15 - 14 * cos(phase));
}

static void test_learns(void)
{
    ts_controller c;
    ts_settings s = settings();
    ts_real plant[2] = {0};
    check(ts_controller_init(&c, &s) == TS_OK, "init accepts good settings");
    double worst = 0;
    for (int k = 0; k < 8000; k++) {
        double error = fabs((double)tick(&c, plant, k));
        if (k >= 6000 && error > worst) worst = error;
    }
    check(worst < 1e-3, "a plant of its own structure is followed within 1 nm after three seconds");
    check(c.counters.rejected == 0 && c.counters.adaptations == 8000, "every measurement was used");
}

static void test_copies(void)
{
    ts_controller a, b, fresh;
    ts_settings s = settings();
    ts_real plant_a[2] = {0}, plant_b[2];
    ts_controller_init(&a, &s);
    ts_controller_init(&fresh, &s);
    for (int k = 0; k < 500; k++) tick(&a, plant_a, k);
    memcpy(&b, &a, sizeof a);
    memcpy(plant_b, plant_a, sizeof plant_a);
    bool same = true;
    for (int k = 500; k < 900; k++) same &= tick(&a, plant_a, k) == tick(&b, plant_b, k);
    check(same && memcmp(&a, &b, sizeof a) == 0, "a copy goes on to the same bits");
    ts_controller_reset(&a);
    check(memcmp(&a, &fresh, sizeof a) == 0, "reset equals fresh");
}

/* The same measurements, once at once and once `late` ticks later with `ago`, teach the same when commands do not
 * depend on what was learned (a held first pass gives them). */
static void test_latency(void)
{
    enum { LATE = 7, LENGTH = 400 };
    ts_controller now, later;
    ts_settings s = settings();
    ts_controller_init(&now, &s);
    ts_controller_init(&later, &s);
    ts_real z[LENGTH], u_now[LENGTH], u_later[LENGTH];
    ts_controller_hold(&now, true);
    ts_controller_hold(&later, true);
    for (int k = 0; k < LENGTH; k++) {
        ts_real volts, z_d = (ts_real)uniform(0, 30), rate = (ts_real)uniform(-300, 300);
        z[k] = (ts_real)uniform(0, 30);
        ts_controller_command(&now, z_d, rate, &volts);
        ts_controller_adapt(&now, z[k], 0);
        u_now[k] = now.innovation;
        ts_controller_command(&later, z_d, rate, &volts);
        if (k < LATE) continue;
        ts_controller_adapt(&later, z[k - LATE], LATE);
        u_later[k - LATE] = later.innovation;
    }
    check(memcmp(u_now, u_later, sizeof(ts_real) * (LENGTH - LATE)) == 0, "a late measurement meets its own command");
    check(ts_controller_adapt(&later, 1, LATE) == TS_REJECTED, "no measurement is used twice");
    check(ts_controller_adapt(&later, 1, TS_HISTORY) == TS_REJECTED, "a measurement beyond the history is rejected");
}

/* ---- Faults ---------------------------------------------------------------------------------------------------------- */

static void test_refusals(void)
{
    ts_controller c, before;
    ts_settings s = settings();
    ts_real volts = 42;
    ts_controller_init(&c, &s);
    memcpy(&before, &c, sizeof c);
    check(ts_controller_command(&c, (ts_real)NAN, 0, &volts) == TS_NOT_FINITE, "NaN is refused");
    check(ts_controller_command(&c, 0, (ts_real)INFINITY, &volts) == TS_NOT_FINITE, "infinity is refused");
    check(volts == 42 && memcmp(&before, &c, sizeof c) == 0, "a refusal changes nothing");

    s.plays = TS_MAX_PLAYS + 1;
    check(ts_controller_init(&c, &s) == TS_BAD_PLAYS, "too many plays");
    s = settings(), s.thresholds[3] = s.thresholds[2];
    check(ts_controller_init(&c, &s) == TS_BAD_THRESHOLDS, "equal thresholds");
    s = settings(), s.dead_zone_weights[0] = 0;
    check(ts_controller_init(&c, &s) == TS_BAD_DEAD_ZONE_WEIGHTS, "a dead-zone slope of 0");
    s = settings(), s.initial_weights[9] = (ts_real)NAN;
    check(ts_controller_init(&c, &s) == TS_BAD_WEIGHTS, "a weight that is NaN");
    s = settings(), s.rate_scale = -1;
    check(ts_controller_init(&c, &s) == TS_BAD_RATE_SCALE, "a negative rate scale");
    s = settings(), s.forgetting = (ts_real)1.01;
    check(ts_controller_init(&c, &s) == TS_BAD_FORGETTING, "a forgetting factor above 1");
    s = settings(), s.regularization = 0;
    check(ts_controller_init(&c, &s) == TS_BAD_REGULARIZATION, "delta of 0");
    s = settings(), s.covariance_limit = 1;
    check(ts_controller_init(&c, &s) == TS_BAD_COVARIANCE_LIMIT, "a limit below the trace of P(0)");
    s = settings(), s.slope_min = 0;
    check(ts_controller_init(&c, &s) == TS_BAD_SLOPE, "a slope limit of 0");
    s = settings(), s.voltage_max = s.voltage_min;
    check(ts_controller_init(&c, &s) == TS_BAD_VOLTAGE, "no voltage range");
}

static bool finite_state(const ts_controller *c)
{
    int m = 2 * c->settings.plays;
    bool ok = true;
    for (int i = 0; i < m; i++) ok &= isfinite(c->w[i]) != 0;
    for (int i = 0; i < m * m; i++) ok &= isfinite(c->S[i]) != 0;
    for (int i = 0; i < c->settings.plays; i++) ok &= isfinite(c->play[i]) != 0;
    return ok;
}

/* Whatever comes, a voltage within limits leaves and the state stays finite. */
static void test_abuse(void)
{
    ts_controller c;
    ts_settings s = settings();
    ts_controller_init(&c, &s);
    bool within = true;
    for (int k = 0; k < 200000; k++) {
        double kind = uniform(0, 1), size = kind < 0.01 ? 1e30 : kind < 0.1 ? 1e4 : 30;
        ts_real volts = 0, z = (ts_real)uniform(-size, size);
        ts_controller_command(&c, (ts_real)uniform(-size, size), (ts_real)uniform(-100 * size, 100 * size), &volts);
        within &= volts >= s.voltage_min && volts <= s.voltage_max;
        if (kind > 0.95) z = (ts_real)(kind > 0.97 ? NAN : INFINITY);
        if (kind < 0.9) ts_controller_adapt(&c, z, (int)uniform(-2, 70));
    }
    check(within, "every voltage is within limits");
    check(finite_state(&c), "the state stays finite under abuse");
    check(c.counters.rejected > 0 && c.counters.adaptations > 0, "bad measurements are counted, good ones are used");
}

static void test_rest(void)
{
    ts_controller c;
    ts_settings s = settings();
    for (int constant = 0; constant < 2; constant++) {
        ts_controller_init(&c, &s);
        for (int k = 0; k < 600000; k++) {
            ts_real volts, z = (ts_real)(10 * constant);
            ts_controller_command(&c, z, 0, &volts);
            ts_controller_adapt(&c, z + (ts_real)uniform(-0.03, 0.03), 0);
        }
        check(finite_state(&c), constant ? "five minutes of one position" : "five minutes of nothing");
    }
}

int main(void)
{
    test_play_bank();
    test_inverse();
    test_rls();
    test_dead_zones();
    test_learns();
    test_copies();
    test_latency();
    test_refusals();
    test_abuse();
    test_rest();
    printf("kernel (%s): %d passed, %d failed\n", sizeof(ts_real) == 8 ? "double" : "float", passed, failed);
    return failed != 0;
}
