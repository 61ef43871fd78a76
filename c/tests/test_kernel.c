/* Tests of the kernel alone: vectors from exact fractions (vectors.py), the algebra of the interface, and faults. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "invariants.h"
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
                     .stroke = 30, .forgetting = (ts_real)0.9999, .regularization = (ts_real)1e-3,
                     .covariance_limit = (ts_real)1e9, .slope_min = (ts_real)0.36, .slope_max = (ts_real)1e9,
                     .voltage_min = (ts_real)-0.6, .voltage_max = (ts_real)3.6, .slew = (ts_real)1e9,
                     .measurement_limit = 300};
    for (int i = 0; i < s.plays; i++) {
        s.thresholds[i] = (ts_real)(i * 0.225);
        s.rate_dependent[i] = true;
    }
    s.initial_weights[0] = 5;
    return s;
}

/* The same plays under the bounded law, with every other term; a prior of independent weights. */
static ts_settings kalman_settings(void)
{
    ts_settings s = settings();
    s.law = TS_LAW_KALMAN;
    s.terms[TS_CREEP] = 2, s.terms[TS_LAG] = 1, s.terms[TS_OFFSET] = 1, s.terms[TS_ASYMMETRY] = 2, s.terms[TS_DUHEM] = 2;
    s.creep[0] = (ts_real)0.15, s.creep[1] = (ts_real)0.0017, s.duhem[0] = (ts_real)4.2, s.duhem[1] = (ts_real)1.05;
    s.slope_min = 3, s.slope_max = 28, s.velocity_limit = 1500, s.slew = (ts_real)0.25;
    s.smoothing = (ts_real)0.5, s.first_noise = (ts_real)0.03, s.initial_weights[0] = 8;
    s.kalman = (ts_kalman_settings){
        .filter = (ts_real)0.6, .noise_rate = (ts_real)1e-3, .ringing_rate = (ts_real)0.1,
        .model_error = (ts_real)6e-3, .prior_return = (ts_real)1e-6, .change_threshold = 12,
        .change_rate = (ts_real)0.2, .refractory = 10, .change_gain = (ts_real)0.15,
        .change_hysteresis = (ts_real)0.3, .change_share = (ts_real)2e-3, .outlier = 12, .outliers = 3};
    static const double sd[] = {0.2, 1, 3e-4, 0.9, 1.5, 1.5, 0.7, 0.7}; /* creep, creep, lag, offset, asymmetry, duhem */
    for (int i = 0; i < 24; i++) {
        double d = i == 0 ? 3 : i < 16 ? 1 : sd[i - 16];
        s.prior[TS_PACKED(i) + i] = (ts_real)(d * d);
    }
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
    ts_rls r;
    ts_real w[TS_PADDED(M)] = {5}, u[TS_PADDED(M)] = {0};
    ts_rls_init(&r, (ts_real)1e-3, M);
    bool ok = true;
    for (int k = 0; k < UPDATES; k++) {
        copy(u, U + k * M, M);
        ok &= ts_rls_update(&r, w, u, (ts_real)E[k], (ts_real)LAMBDA, (ts_real)1e9, M);
        for (int i = 0; i < M; i++) ok &= near(w[i], W[k * M + i], 50);
        ok &= near(r.trace, TRACE[k], 40 * TRACE[0]);
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

/* A linear plant of 9 um/V that takes 5 % of another axis, 1e-5 s of its velocity and 1e-7 s^2 of its acceleration. */
static void test_coupling(void)
{
    static const double share[3] = {0.05, 1e-5, 1e-7};
    ts_controller c, alone;
    ts_settings s = kalman_settings();
    s.terms[TS_COUPLING] = s.terms[TS_COUPLING_LAG] = 1;
    check(ts_controller_init(&c, &s) == TS_BAD_TERMS, "three terms of coupling for each other axis");
    s.terms[TS_COUPLING_INERTIA] = 1;
    for (int i = 0; i < 3; i++) s.prior[TS_PACKED(24 + i) + 24 + i] = (ts_real)(share[i] * share[i]);
    check(ts_controller_init(&c, &s) == TS_OK, "init accepts another axis");
    double worst = 0;
    for (int k = 0; k < 8000; k++) {
        double a = 0.01 * k, b = 0.07 * k, w = 0.07 * 2000, y[3] = {15 + 10 * sin(b), 10 * w * cos(b), -10 * w * w * sin(b)};
        ts_real others[3] = {(ts_real)y[0], (ts_real)y[1], (ts_real)y[2]}, volts = 0, z_d = (ts_real)(15 - 10 * cos(a));
        ts_controller_follow(&c, z_d, (ts_real)(200 * sin(a)), (ts_real)(4000 * cos(a)), (ts_real)NAN, others, &volts);
        double z = 9 * (double)volts;
        for (int i = 0; i < 3; i++) z += share[i] * y[i];
        ts_controller_adapt(&c, (ts_real)z, 0);
        if (k >= 6000 && fabs(z - (double)z_d) > worst) worst = fabs(z - (double)z_d);
    }
    check(worst < 2e-3, "what another axis does is learned: within 2 nm of half a um after three seconds");
    alone = c;
    ts_real bad[3] = {0, (ts_real)NAN, 0}, volts = 7;
    check(ts_controller_follow(&c, 0, 0, 0, 0, bad, &volts) == TS_NOT_FINITE && memcmp(&alone, &c, sizeof c) == 0 && !(volts < 7),
          "a motion of another axis that is not finite is refused, and nothing has changed");
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

/* The same measurements, once at once and once `late` ticks later with `ago`, have the same effect when commands do not
 * depend on what was learned (a held first pass gives them). */
/* After a silence the law passes over what is older than TS_BACKLOG, tick by tick, unless measurements come later than that. */
static void test_silence_is_passed_over(void)
{
    ts_controller c;
    ts_settings s = settings();
    ts_real volts;
    for (int late = 0; late < 300; late += 150) {
        ts_controller_init(&c, &s);
        for (int k = 0; k < 600; k++) {
            ts_controller_command(&c, 1, 0, &volts);
            if (k >= late && k < 400) ts_controller_adapt(&c, 1, late);
        }
        check(c.counters.commands - c.lagged.ticks == (uint64_t)(late + TS_BACKLOG), "only so many commands wait");
        check(ts_controller_adapt(&c, 1, late) == TS_OK, "a measurement after the silence is used");
    }
}

/* Then none of them waits for the first good measurement, which takes no longer than another one. */
static void test_what_is_lost_is_passed_over_in_its_own_tick(void)
{
    ts_controller c;
    ts_settings s = settings();
    ts_real volts;
    ts_controller_init(&c, &s);
    for (int k = 0; k < 100; k++) {
        ts_controller_command(&c, 1, 0, &volts);
        bool lost = k >= 50 && k < 90;
        check(ts_controller_adapt(&c, lost ? (ts_real)NAN : 1, 0) == (lost ? TS_REJECTED : TS_OK), "only what is lost is rejected");
        check(c.lagged.ticks == c.counters.commands, "no tick waits");
    }
}

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
    check(ts_controller_init(&c, &s) == TS_BAD_RLS, "a forgetting factor above 1");
    s = settings(), s.regularization = 0;
    check(ts_controller_init(&c, &s) == TS_BAD_RLS, "delta of 0");
    s = settings(), s.covariance_limit = 1;
    check(ts_controller_init(&c, &s) == TS_BAD_RLS, "a limit below the trace of P(0)");
    s = settings(), s.slope_min = 0;
    check(ts_controller_init(&c, &s) == TS_BAD_SLOPE, "a slope limit of 0");
    s = settings(), s.slope_max = s.slope_min;
    check(ts_controller_init(&c, &s) == TS_BAD_SLOPE, "no range of slopes");
    s = settings(), s.voltage_max = s.voltage_min;
    check(ts_controller_init(&c, &s) == TS_BAD_VOLTAGE, "no voltage range");
    s = settings(), s.slew = 0;
    check(ts_controller_init(&c, &s) == TS_BAD_VOLTAGE, "a slew limit of 0");
    s = settings(), s.smoothing = 1;
    check(ts_controller_init(&c, &s) == TS_BAD_LIMIT, "a smoothing that never ends");
    s = kalman_settings(), s.creep[1] = 0;
    check(ts_controller_init(&c, &s) == TS_BAD_TERMS, "a creep state that stands still");
    s = kalman_settings(), s.duhem[1] = 0;
    check(ts_controller_init(&c, &s) == TS_BAD_TERMS, "a state of Duhem that forgets at once");
    s = kalman_settings(), s.terms[TS_DUHEM] = TS_MAX_DUHEM + 1;
    check(ts_controller_init(&c, &s) == TS_BAD_TERMS, "too many states of Duhem");
    s = kalman_settings(), s.prior[TS_PACKED(3) + 3] = 0;
    check(ts_controller_init(&c, &s) == TS_BAD_KALMAN, "a prior variance of 0");
    s = kalman_settings(), s.prior_from[3] = 8;
    check(ts_controller_init(&c, &s) == TS_BAD_KALMAN, "a row of the prior that begins behind its diagonal");
    s = kalman_settings(), s.prior_from[20] = 4;
    check(ts_controller_init(&c, &s) == TS_BAD_KALMAN, "a row of the prior that begins within a block");
    s = kalman_settings(), s.kalman.filter = 0;
    check(ts_controller_init(&c, &s) == TS_BAD_KALMAN, "a filter that lets nothing through");
}

/* Whatever comes, a voltage within limits leaves, the state stays finite, and the bounded law finds its way back. */
static void abuse(int law, uint32_t start)
{
    ts_controller c;
    ts_settings s = law ? kalman_settings() : settings();
    ts_controller_init(&c, &s);
    seed = start * 2654435761u;
    bool within = true, finite = true;
    ts_real last = 0;
    for (int k = 0; k < 20000; k++) {
        double kind = uniform(0, 1), size = kind < 0.01 ? 1e30 : kind < 0.1 ? 1e4 : 30;
        ts_real volts = 0, z = (ts_real)uniform(-size, size);
        ts_controller_command(&c, (ts_real)uniform(-size, size), (ts_real)uniform(-100 * size, 100 * size), &volts);
        within &= volts >= s.voltage_min && volts <= s.voltage_max;
        within &= fabs((double)volts - (double)last) <= (double)s.slew * (1 + 1e-6);
        last = volts;
        if (kind > 0.95) z = (ts_real)(kind > 0.97 ? NAN : INFINITY);
        if (kind < 0.9) ts_controller_adapt(&c, z, (int)uniform(-2, 70));
        if (k % 100 == 0) finite &= finite_state(&c);
    }
    ts_real volts;
    ts_controller_command(&c, sizeof(ts_real) == 8 ? (ts_real)1e200 : (ts_real)1e30, 0, &volts);
    ts_controller_adapt(&c, 10, 0);
    check(finite_state(&c), "an absurd desired displacement leaves a finite state");
    check(within, "every voltage is within limits and slew");
    check(finite && finite_state(&c), "the state stays finite under abuse");
    check(c.counters.rejected > 0 && c.counters.adaptations > 0, "bad measurements are counted, good ones are used");
    if (!law) return;
    check(definite(c.law.kalman.P, ts_parameters(&s)), "P is positive definite after abuse");
    ts_real plant[2] = {c.now.play[0], c.now.play[0]};
    double worst = 0;
    for (int k = 0; k < 6000; k++) {
        double error = fabs((double)tick(&c, plant, k));
        if (k > 4000 && error > worst) worst = error;
    }
    check(worst < 0.05, "and after all of it the actuator is followed again");
}

static void test_abuse(void)
{
    for (uint32_t start = 1; start <= 12; start++) abuse(1, start); /* two of them once locked the controller up */
    for (uint32_t start = 1; start <= 3; start++) abuse(0, start);
}

static bool positive_factor(const ts_controller *c)
{
    bool ok = true;
    for (int i = 0; i < c->parameters; i++) ok &= c->law.rls.D[i] > 0;
    return ok;
}

static void test_rest(void)
{
    ts_controller c;
    for (int constant = 0; constant < 2; constant++) {
        for (int law = 0; law < 2; law++) {
            ts_settings s = law ? kalman_settings() : settings();
            ts_controller_init(&c, &s);
            for (int k = 0; k < 100000; k++) {
                ts_real volts, z = (ts_real)(10 * constant);
                ts_controller_command(&c, z, 0, &volts);
                ts_controller_adapt(&c, z + (ts_real)uniform(-0.03, 0.03), 0);
            }
            check(finite_state(&c), constant ? "50 s of one position" : "50 s of nothing");
            check(law ? definite(c.law.kalman.P, ts_parameters(&s)) : positive_factor(&c),
                  "P is positive definite after rest");
        }
    }
}

/* ---- The bounded law ------------------------------------------------------------------------------------------------ */

static const ts_kalman_settings EXACT = { /* of vectors.py: the noise is fixed, (0.125 um)^2 + (0.125 um)^2 */
    .filter = (ts_real)0.5, .model_error = (ts_real)0.125, .prior_return = (ts_real)0.03125, .change_threshold = 8,
    .change_rate = (ts_real)0.25, .refractory = K_REFRACTORY, .change_gain = (ts_real)0.25,
    .change_hysteresis = (ts_real)0.375, .change_share = (ts_real)0.125, .outlier = (ts_real)1e6, .outliers = 3};

static ts_kalman exact_filter(ts_real *w, ts_real *P0)
{
    ts_kalman k;
    memset(w, 0, sizeof(ts_real) * TS_PADDED(K_M));
    copy(w, K_W0, K_M);
    copy(P0, K_P0, TS_PACKED(K_M));
    ts_kalman_init(&k, (ts_prior){P0, NULL}, (ts_real)0.125, K_M);
    k.filter = EXACT.filter;
    for (int i = 0; i < K_M - 1; i++) k.part[i] = i ? 2 : 1;
    return k;
}

static int packed_place(int i) /* of entry i of a packed triangle in the rows of ours */
{
    int row = 0;
    for (; i > row; row++) i -= row + 1;
    return TS_ROW(row) + i;
}

/* A tick as the controller takes it: y is NULL where no measurement came; a spike is replaced by what is expected. */
static bool kalman_tick(ts_kalman *k, const ts_kalman_settings *s, const ts_real *w0, const ts_real *P0, ts_real *w,
                        const ts_real *u, const ts_real *y)
{
    ts_real predicted = ts_dot(u, w, TS_PADDED(K_M)), innovation = y ? *y - predicted : 0;
    bool measured = y && !ts_kalman_is_spike(k, s, innovation, innovation, false);
    if (!measured) innovation = 0;
    return ts_kalman_tick(k, s, w0, (ts_prior){P0, NULL}, w, u, predicted + innovation, innovation, measured, true, K_M);
}

static void test_kalman(void)
{
    ts_real w[TS_PADDED(K_M)], w0[TS_PADDED(K_M)], P0[TS_PACKED(K_M)], u[TS_PADDED(K_M)] = {0};
    ts_kalman k = exact_filter(w, P0);
    memcpy(w0, w, sizeof w);
    bool weights = true, covariance = true, changes = true;
    for (int t = 0; t < K_TICKS; t++) {
        ts_real y = (ts_real)K_Y[t];
        copy(u, K_U + t * K_M, K_M);
        bool used = kalman_tick(&k, &EXACT, w0, P0, w, u, &y);
        weights &= used == (t % 2 == 0);
        changes &= k.changed == (K_CHANGED[t] == 1);
        for (int i = 0; i < K_M; i++) weights &= near(w[i], K_W[t * K_M + i], 50);
        for (int i = 0; t % 2 && i < TS_PACKED(K_M); i++) covariance &= near(k.P[packed_place(i)], K_P[t / 2 * TS_PACKED(K_M) + i], 10);
    }
    check(weights, "weights of the Kalman filter: information form, exact");
    check(covariance, "its covariance, return to the prior and growth after a change");
    check(changes, "its change is found in the same tick");
}

/* What a year may bring: rest, one position, one sine, spikes, no measurement at all, wrong readings. */
static void test_kalman_bounds(void)
{
    enum { LENGTH = 60000 };
    static const char *name[] = {"rest", "one position", "one sine", "spikes", "no sensor", "wave", "wrong readings"};
    for (int kind = 0; kind < 7; kind++) {
        ts_real w[TS_PADDED(K_M)], w0[TS_PADDED(K_M)], P0[TS_PACKED(K_M)];
        ts_kalman_settings s = EXACT;
        s.outlier = 12, s.noise_rate = (ts_real)1e-3, s.ringing_rate = (ts_real)0.1, s.prior_return = (ts_real)1e-6;
        s.model_error = (ts_real)0.006;
        ts_kalman k = exact_filter(w, P0);
        memcpy(w0, w, sizeof w);
        bool bounded = true, spd = true, within = true, apart = true;
        int last = -K_REFRACTORY;
        for (int t = 0; t < LENGTH; t++) {
            double x = kind == 0 ? 0 : kind == 1 ? 1 : kind == 5 ? uniform(-1, 3) : 1 + sin(0.01 * t);
            ts_real u[TS_PADDED(K_M)] = {(ts_real)x, (ts_real)(0.9 * x), (ts_real)(x > 1 ? x - 1 : 0), 1};
            double y = 8 * u[0] + 2.5 * u[1] + 0.5 * u[2] + 0.5 + uniform(-0.03, 0.03);
            if (kind == 3 && t % 50 > 46) y += 20;
            if (kind == 6) y = uniform(-300, 300);
            ts_real measured = (ts_real)y;
            kalman_tick(&k, &s, w0, P0, w, u, kind == 4 && t > 100 ? NULL : &measured);
            if (k.changed && k.since_change == 0) {
                apart &= t - last >= K_REFRACTORY;
                last = t;
            }
            for (int i = 0; i < K_M; i++) {
                double sd = sqrt((double)P0[TS_PACKED(i) + i]);
                within &= fabs((double)w[i] - (double)w0[i]) < 4 * sd;
                bounded &= fabs((double)w[i]) < 1e4 && k.P[TS_ROW(i) + i] < (kind == 6 ? 1e4 : 4 * sd * sd);
            }
            if (t % 500 == 499) spd &= definite(k.P, K_M);
        }
        check(bounded, name[kind]);
        check(spd, "P stays positive definite");
        check(apart && (kind != 6 || last > 0), "wrong readings are a change at most once in a refractory time");
        if (kind != 6) check(within, "weights stay within what the prior holds for possible");
    }
}

/* P0 + d d' and a weight that stands by itself: made in the tick after, in which and until the wait is over nothing is learned. */
static void test_covariance_of_the_next_tick(void)
{
    enum { ALONE = 1, WAIT = 3 };
    ts_real w[TS_PADDED(K_M)], w0[TS_PADDED(K_M)], P0[TS_PACKED(K_M)], d[TS_PADDED(K_M)] = {1, 2, -1, (ts_real)0.5};
    const ts_real u[TS_PADDED(K_M)] = {1, 1, 0, 1}, y = 3;
    ts_kalman k = exact_filter(w, P0);
    memcpy(w0, w, sizeof w);
    for (int t = 0; t < 2; t++) kalman_tick(&k, &EXACT, w0, P0, w, u, &y);
    ts_real before = k.P[0];
    ts_kalman_renew(&k, d, WAIT, K_M);
    ts_kalman_separate(&k, ALONE, 7, K_M);
    check(k.P[0] == before, "a tick with much to do leaves the covariance to the next one");
    ts_kalman again = k;
    int ticks = 0, right = 0;
    while (!kalman_tick(&k, &EXACT, w0, P0, w, u, &y) && ticks < 100) ticks++;
    check(ticks == WAIT - 1, "the weights stay for so many ticks");
    ts_kalman_complete(&again, (ts_prior){P0, NULL}, K_M);
    for (int i = 0; i < TS_PACKED(K_M); i++) {
        int row = 0;
        for (int rest = i; rest > row; row++) rest -= row + 1;
        int column = i - TS_PACKED(row);
        ts_real wanted = row == ALONE || column == ALONE ? (row == column ? 7 : 0) : P0[i] + d[row] * d[column];
        right += again.P[packed_place(i)] == wanted && k.P[packed_place(i)] == wanted;
    }
    check(right == TS_PACKED(K_M), "P is P(0) + d d', and a weight that stands by itself has its variance");
    ts_kalman_renew(&again, d, WAIT, K_M);
    ts_kalman_separate(&again, ALONE, 7, K_M);
    ts_kalman_reset_covariance(&again, (ts_prior){P0, NULL}, K_M);
    ts_kalman_complete(&again, (ts_prior){P0, NULL}, K_M);
    right = 0;
    for (int i = 0; i < TS_PACKED(K_M); i++) right += again.P[packed_place(i)] == P0[i];
    check(right == TS_PACKED(K_M) && memcmp(again.part, k.part, sizeof k.part) == 0, "a reset forgets what was to be made");
}

static void test_spikes_and_changes(void)
{
    ts_controller c, before;
    ts_settings s = kalman_settings();
    ts_real plant[2] = {0}, volts;
    ts_controller_init(&c, &s);
    for (int k = 0; k < 4000; k++) tick(&c, plant, k);
    memcpy(&before, &c, sizeof c);
    ts_real expected = 9 * plant[0] + 4 * plant[1];
    for (int k = 0; k < 4; k++) {
        ts_controller_command(&c, c.motion[(c.counters.commands - 1) % TS_HISTORY].z_d, 0, &volts);
        ts_status status = ts_controller_adapt(&c, expected + 10, 0);
        check((status == TS_REJECTED) == (k < 3) && c.flags.rejected == (k < 3), "three spikes are rejected, a fourth is used");
    }
    memcpy(&c, &before, sizeof c);
    uint64_t fired = c.counters.changed, last = 0;
    bool apart = true;
    for (int k = 4000; k < 4400; k++) { /* the branches are 20 % shorter from now on */
        ts_real z_d = (ts_real)(15 - 14 * cos(0.02 * k)), rate = (ts_real)(560 * sin(0.02 * k));
        ts_controller_command(&c, z_d, rate, &volts);
        ts_play_bank(volts, (ts_real[]){0, (ts_real)0.45}, plant, 2);
        ts_controller_adapt(&c, (ts_real)0.8 * (9 * plant[0] + 4 * plant[1]), 0);
        if (c.flags.changed) {
            apart &= last == 0 || c.counters.commands - last >= (uint64_t)s.kalman.refractory;
            last = c.counters.commands;
        }
    }
    check(c.counters.changed > fired && last < 4000 + 400, "a sudden change is found");
    check(apart, "at most once in a refractory time");
}

static void test_silence(void)
{
    ts_real w[TS_PADDED(K_M)], w0[TS_PADDED(K_M)], P0[TS_PACKED(K_M)], u[TS_PADDED(K_M)] = {0}, y = 0;
    ts_kalman_settings s = EXACT;
    s.noise_rate = (ts_real)1e-2, s.ringing_rate = (ts_real)0.1, s.outlier = 12;
    ts_kalman k = exact_filter(w, P0);
    memcpy(w0, w, sizeof w);
    for (int t = 0; t < 200000; t++) kalman_tick(&k, &s, w0, P0, w, u, &y);
    for (int t = 0; t < 3000; t++) {
        y = (ts_real)uniform(-0.5, 0.5);
        kalman_tick(&k, &s, w0, P0, w, u, &y);
    }
    check(near(k.sigma, 0.28, 0.06 / EPS), "the noise is found again after a sensor was silent for long");

    s.model_error = 0;
    k = exact_filter(w, P0), y = 0;
    for (int t = 0; t < 200000; t++) kalman_tick(&k, &s, w0, P0, w, u, &y);
    bool finite = true;
    for (int i = 0; i < K_M; i++) finite &= isfinite(w[i]) != 0;
    check(finite, "nothing at all is not divided by nothing");
}

static void test_shared_sums(void)
{
    enum { WIDE = 3 * TS_LANES + 5 };
    static ts_kalman k;
    for (int i = 0; i < WIDE; i++) {
        k.part[i] = (uint8_t)(i % 3);
        for (int j = 0; j <= i; j++) { /* rows go on to the end of the block that holds the diagonal */
            ts_real entry = i == j ? 2 * WIDE : (ts_real)uniform(-1, 1);
            k.P[TS_ROW(i) + j] = entry;
            if (j - j % TS_LANES == i - i % TS_LANES) k.P[TS_ROW(j) + i] = entry;
        }
    }
    bool same = true, padded = true;
    for (int first = 1; first <= WIDE; first++)
        for (int second = 1; second <= WIDE; second++) {
            ts_real shared[TS_PADDED(WIDE)] = {0}, alone[TS_PADDED(WIDE)] = {0};
            ts_column_sums sums, one, other;
            memset(&sums, 0xff, sizeof sums); /* no numbers: what is not computed is not read */
            one = other = sums;
            sums.columns = one.columns = other.columns = 0;
            ts_kalman_project(&k, shared, &sums, first, (ts_real)0.75, 1, WIDE);
            ts_kalman_project(&k, shared, &sums, second, (ts_real)-0.75, 1, WIDE);
            ts_kalman_project(&k, alone, &one, first, (ts_real)0.75, 1, WIDE);
            ts_kalman_project(&k, alone, &other, second, (ts_real)-0.75, 1, WIDE);
            same &= memcmp(shared, alone, sizeof shared) == 0;
            for (int i = WIDE; i < TS_PADDED(WIDE); i++) padded &= shared[i] == 0;
        }
    check(same, "a projection that goes on from sums of another has the bits of one by itself");
    check(padded, "and what fills the last block of the weights stays 0");
}

static void test_project(void)
{
    ts_real w[TS_PADDED(K_M)], P0[TS_PACKED(K_M)], g[TS_PADDED(K_M)] = {1, 1, 0, 0};
    ts_kalman k = exact_filter(w, P0);
    ts_real before[TS_PADDED(K_M)], nearest = 0;
    memcpy(before, w, sizeof w);
    ts_column_sums sums = {.columns = 0};
    ts_kalman_project(&k, w, &sums, 2, 1, 3 - (w[0] + w[1]), K_M);
    check(near(w[0] + w[1], 3, 10), "the projection is on the plane");
    /* P^-1 (w - before) is along g: the condition of the smallest distance in the metric of P^-1 (Lagrange). */
    double P[K_M][K_M], d[K_M], multiplier = 0;
    for (int i = 0; i < K_M; i++) for (int j = 0; j <= i; j++) P[i][j] = P[j][i] = k.P[TS_ROW(i) + j];
    for (int i = 0; i < K_M; i++) d[i] = w[i] - before[i];
    for (int i = 0; i < K_M; i++) { /* Gauss */
        for (int r = i + 1; r < K_M; r++) {
            double f = P[r][i] / P[i][i];
            for (int j = i; j < K_M; j++) P[r][j] -= f * P[i][j];
            d[r] -= f * d[i];
        }
    }
    for (int i = K_M - 1; i >= 0; i--) {
        for (int j = i + 1; j < K_M; j++) d[i] -= P[i][j] * d[j];
        d[i] /= P[i][i];
    }
    multiplier = d[0];
    for (int i = 0; i < K_M; i++) nearest += (ts_real)fabs(d[i] - (g[i] > 0 ? multiplier : 0));
    check(multiplier < 0 && near(nearest, 0, 10), "and nearest in the metric of P^-1");
}

/* Slopes at both ends of the rates that were commanded: a weight b that is too large breaks the limit at -v, one that is too small at +v. */
static void test_slopes_at_both_ends(void)
{
    for (int sign = -1; sign <= 1; sign += 2) {
        ts_controller c;
        ts_settings s = kalman_settings();
        s.initial_weights[1] = (ts_real)(sign * 0.7); /* 8 - 0.007 * 1500 * 0.7 = 0.65 < 3 */
        ts_real volts;
        ts_controller_init(&c, &s);
        for (int k = 0; k < 3; k++) {
            ts_controller_command(&c, (ts_real)(0.1 * k), k ? 0 : (ts_real)2000, &volts); /* beyond the velocity limit */
            ts_controller_adapt(&c, (ts_real)(0.1 * k), 0);
        }
        double slope = c.w[0] - 0.007 * 1500 * fabs((double)c.w[1]);
        check(slope > 3 - 1e-3, "slopes are admissible at both ends of the rates");
    }
}

/* ---- Safety of the command ------------------------------------------------------------------------------------------- */

static void test_limited_tick_is_not_used(void)
{
    ts_controller c;
    ts_settings s = kalman_settings();
    ts_real plant[2] = {0}, volts, w[TS_MAX_PARAMETERS];
    ts_controller_init(&c, &s);
    for (int k = 0; k < 2000; k++) tick(&c, plant, k);
    memcpy(w, c.w, sizeof w);
    for (int k = 0; k < 100; k++) { /* far away: first the slew, then the voltage limit; the sensor gives wrong readings */
        ts_controller_command(&c, k < 50 ? 100 : -100, 0, &volts);
        ts_controller_adapt(&c, (ts_real)uniform(10, 20), 0);
    }
    check(memcmp(w, c.w, sizeof(ts_real) * (size_t)ts_parameters(&s)) == 0, "a limited tick does not change the weights");
    plant[0] = volts, plant[1] = volts + (ts_real)0.45;
    double worst = 0;
    for (int k = 2000; k < 2600; k++) {
        double error = fabs((double)tick(&c, plant, k));
        if (k > 2100 && error > worst) worst = error;
    }
    check(worst < 0.05, "nor does its trace in the filters");
}

static void test_hold(void)
{
    ts_controller c;
    ts_settings s = kalman_settings();
    s.kalman.prior_return = (ts_real)0.01;
    ts_real plant[2] = {0}, w[TS_MAX_PARAMETERS];
    bool same = true;
    ts_controller_init(&c, &s);
    for (int at = 100; at < 132; at++) {
        ts_controller_hold(&c, false);
        for (int k = 0; k < at; k++) tick(&c, plant, k);
        memcpy(w, c.w, sizeof w);
        ts_controller_hold(&c, true);
        for (int k = at; k < at + 5; k++) tick(&c, plant, k);
        same &= memcmp(w, c.w, sizeof w) == 0;
    }
    check(same, "on hold no weight moves, at whatever tick it begins");
}

static void test_start_and_change(void)
{
    for (int kind = 0; kind < 4; kind++) { /* with and without an offset; slopes within limits or clamped */
        ts_controller c;
        ts_settings s = kalman_settings();
        s.terms[TS_OFFSET] = kind % 2;
        if (kind > 1) s.slope_min = 10;
        if (!s.terms[TS_OFFSET]) for (int i = 19; i < 21; i++) s.prior[TS_PACKED(i) + i] = 2;
        ts_real volts, first;
        check(ts_controller_init(&c, &s) == TS_OK, "init");
        check(ts_controller_start(&c, (ts_real)1.25, 17) == TS_OK, "start");
        ts_controller_command(&c, 17, 0, &volts);
        check(near(volts, 1.25, 30), "start takes over without a jump");
        for (int k = 0; k < 200; k++) {
            ts_controller_command(&c, 17, 0, &volts);
            ts_controller_adapt(&c, 10 * volts + (ts_real)4.5, 0);
        }
        first = volts;
        ts_settings next = s;
        next.slope_min = 9, next.dead_zone_weights[0] = (ts_real)1.1;
        check(ts_controller_change(&c, &next) == TS_OK, "change");
        ts_controller_command(&c, 17, 0, &volts);
        check(fabs((double)(volts - first)) < 2e-3, "settings change without a jump");
        s.plays = 5;
        check(ts_controller_change(&c, &s) == TS_BAD_TERMS, "another model is refused");
    }
}

/* The trim alone, adaptation on hold: 10 um/V and an offset that nobody knows. */
static void test_trim(void)
{
    ts_controller c;
    ts_settings s = kalman_settings();
    s.trim = (ts_real)0.02;
    ts_real volts = 0, z = 0;
    ts_controller_init(&c, &s);
    ts_controller_hold(&c, true);
    for (int k = 0; k < 3000; k++) {
        ts_controller_command(&c, 10, 0, &volts);
        ts_controller_adapt(&c, z = 10 * volts + 3, 0);
    }
    check(near(z, 10, 1e-3 / EPS), "the trim removes the error");
    for (int k = 0; k < 5000; k++) { /* out of reach: no windup */
        ts_controller_command(&c, 50, 0, &volts);
        ts_controller_adapt(&c, 10 * volts + 3, 0);
    }
    check(fabs((double)c.integral) < 30, "out of reach the integral waits");
    for (int k = 0; k < 1000; k++) { /* a plausible sensor error drives it to the limit */
        ts_controller_command(&c, 10, 0, &volts);
        ts_controller_adapt(&c, (ts_real)(-50 + uniform(-0.01, 0.01)), 0);
    }
    check(volts == s.voltage_max, "a wrong sensor can drive it to the limit");
    for (int k = 0; k < 3000; k++) {
        ts_controller_command(&c, 10, 0, &volts);
        ts_controller_adapt(&c, z = 10 * volts + 3, 0);
    }
    check(near(z, 10, 1e-3 / EPS), "and it comes back from there");
}

/* ---- Repetition ---------------------------------------------------------------------------------------------------- */

enum { PHASES = 100 };
static ts_real wave[PHASES], table[PHASES];

static double of_period(double places) { return places / (double)PHASES; }

static double form(double turns) { return cos(6.283185307179586 * turns) + 0.2 * sin(18.84955592153876 * turns); }

/* Of a motion of 6 um about 5 um: 0.1 V in a sine that is 0.2 turns early, and 0.3 V. */
static ts_learned_period learned_period(void)
{
    double power = 0, slopes = 0, low = 1e9, high = -1e9, cosine = 0, sine = 0;
    for (int k = 0; k < PHASES; k++) {
        double x = 3 * form(of_period(k)), d = 1.5 * (form(of_period(k + 1.0)) - form(of_period(k - 1.0)));
        double turn = 6.283185307179586 * of_period(k);
        wave[k] = (ts_real)(5 + x);
        table[k] = (ts_real)(0.1 * sin(turn + 6.283185307179586 * 0.2));
        power += x * x, slopes += d * d, cosine += x * cos(turn), sine += x * sin(turn);
        low = x < low ? x : low, high = x > high ? x : high;
    }
    ts_shape shape = {wave, 5, (ts_real)(high - low), (ts_real)power, (ts_real)slopes, (ts_real)cosine, (ts_real)sine};
    return (ts_learned_period){shape, table, (ts_real)0.3, 10};
}

static ts_repetition_settings repetition_settings(const ts_learned_period *learned)
{
    return (ts_repetition_settings){.size = PHASES, .period = (ts_real)PHASES, .change = 20, .share = (ts_real)0.3, .cosine = (ts_real)cos(6.283185307179586 * of_period(1)),
                                    .sine = (ts_real)sin(6.283185307179586 * of_period(1)), .ratio = 2, .settles = 40, .learned = learned};
}

/* A period that is 0.7 % longer, a smaller amplitude, another offset and phase. */
static double moving(int k) { return 2 + 0.6 * (5 + 3 * form(k / 100.7 + 0.37)); }

static void test_repetition(void)
{
    ts_real memory[2 * PHASES], last = 0;
    ts_learned_period learned = learned_period();
    ts_repetition_settings s = repetition_settings(&learned);
    ts_repetition r, before;
    double largest = 0, bump = 0;
    check(ts_repetition_init(&r, &s, memory), "a repetition begins");
    for (int k = 0; k < 4000; k++) {
        ts_repetition_tick(&r, (ts_real)moving(k));
        ts_real volts = ts_repetition_volts(&r, 1, -5, 5, 5);
        double expected = 1.3 + 0.06 * sin(6.283185307179586 * (k / 100.7 + 0.57));
        if (k > 2000) largest = fmax(largest, fabs((double)volts - expected));
        if (k > 0) bump = fmax(bump, fabs((double)(volts - last)));
        last = volts;
        if (k < 200) check(volts >= 1 && volts <= 1, "two periods show nothing yet");
    }
    check(r.joined && r.corrects && sound(&r), "a motion of the learned form is joined");
    check(largest < 1e-3, "with its amplitude, at its phase");
    check(bump < 15.0 / 8 * 0.36 / 20 + 0.004, "without a bump");
    before = r;
    check(!ts_repetition_tick(&r, (ts_real)NAN) && !ts_repetition_tick(&r, (ts_real)INFINITY), "what is not finite is refused");
    check(memcmp(&before, &r, sizeof r) == 0, "and changes nothing");
    for (int k = 0; k < 100; k++) {
        ts_repetition_tick(&r, 5);
        ts_real volts = ts_repetition_volts(&r, 1, -5, 5, 5);
        check(fabs((double)(volts - last)) < 15.0 / 8 * 0.36 / 20 + 0.004, "it is left without a bump");
        last = volts;
    }
    check(!r.joined && !r.corrects && last >= 1 && last <= 1, "at rest the controller is alone");
    ts_repetition_settings bad = s;
    bad.size = 8;
    check(!ts_repetition_init(&r, &bad, memory), "a period that is too short is refused");
}

int main(void)
{
    test_play_bank();
    test_inverse();
    test_rls();
    test_dead_zones();
    test_learns();
    test_coupling();
    test_copies();
    test_latency();
    test_silence_is_passed_over();
    test_what_is_lost_is_passed_over_in_its_own_tick();
    test_refusals();
    test_abuse();
    test_rest();
    test_kalman();
    test_kalman_bounds();
    test_covariance_of_the_next_tick();
    test_spikes_and_changes();
    test_silence();
    test_project();
    test_shared_sums();
    test_slopes_at_both_ends();
    test_limited_tick_is_not_used();
    test_hold();
    test_start_and_change();
    test_trim();
    test_repetition();
    printf("kernel (%s): %d passed, %d failed\n", sizeof(ts_real) == 8 ? "double" : "float", passed, failed);
    return failed != 0;
}
