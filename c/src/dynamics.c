/* The stage between hysteresis and sensor: G predicts the measurement, A takes the modes out of it, A G does so with the regressor. */
#include "controller.h"

#include <string.h>

/* The states of G after a long rest with this strain, um. */
void ts_rest_sections(ts_controller *c, ts_real strain)
{
    const ts_dynamics *g = dynamics_of(c);
    for (int i = 0; i < g->sections; i++) {
        const ts_real *q = g->section[i];
        ts_real *y = c->dynamics.section[i];
        y[0] = y[1] = (q[0] + q[1]) * strain / (1 + q[2] + q[3]);
    }
}

/* G: the measurement that the model expects of the next tick, um. At rest before the first one. */
ts_real ts_expected(ts_controller *c)
{
    const ts_dynamics *g = dynamics_of(c);
    ts_dynamics_state *d = &c->dynamics;
    ts_real u[4], z = 0; /* the strain `dead` ticks ago, and before that */
    for (int i = 0; i < 4; i++) u[i] = strain_of(c, g->dead + i);
    if (d->ticks == 0) ts_rest_sections(c, u[0]);
    for (int i = 0; i < g->sections; i++) {
        const ts_real *q = g->section[i];
        ts_real *y = d->section[i];
        ts_real next = q[0] * u[0] + q[1] * u[1] - q[2] * y[0] - q[3] * y[1];
        y[1] = y[0];
        y[0] = next;
        z += next;
    }
    for (int i = 0; i < 3; i++) z += g->direct[i] * u[i];
    return z;
}

/* A: the measurement without the modes, um. */
ts_real ts_notched(ts_controller *c, ts_real z)
{
    const ts_dynamics *g = dynamics_of(c);
    ts_dynamics_state *d = &c->dynamics;
    /* At rest before the first regressor: noise of which a part alone went into the law's filters would be a jump, thousands of times
     * as large where f0 is far below the sample rate. */
    bool rests = c->lagged.ticks == 0 || d->stands;
    if (rests) d->z[0] = d->z[1] = z;
    ts_real y = g->notch[0] * z + g->notch[1] * d->z[0] + g->notch[2] * d->z[1];
    d->z[1] = d->z[0];
    d->z[0] = z;
    for (int i = 0; i < g->modes; i++) {
        const ts_real *q = g->mode[i];
        ts_real *x = d->mode[i];
        if (rests) {
            x[1] = (q[2] - q[4]) * y;
            x[0] = (q[1] - q[3]) * y + x[1];
        }
        ts_real in = y;
        y = q[0] * in + x[0];
        x[0] = q[1] * in - q[3] * y + x[1];
        x[1] = q[2] * in - q[4] * y;
    }
    return y;
}

/* The innovation without the first mode, as noisy as it was: ringing that the model knows is no noise. um. */
ts_real ts_quiet(const ts_controller *c, ts_real innovation)
{
    const ts_real *a = dynamics_of(c)->quiet, *before = c->dynamics.innovation;
    return a[0] * innovation + a[1] * before[0] + a[2] * before[1];
}

/* The states of A G after a long rest with the regressor of this tick. */
static void rest_stage(ts_controller *c)
{
    const ts_dynamics *g = dynamics_of(c);
    ts_dynamics_state *d = &c->dynamics;
    for (int i = 0; i < c->parameters; i += TS_LANES) {
        lanes x = load(c->u + i), s = zero();
        for (int k = TS_TAPS - 2; k >= 0; k--) {
            s = plus(s, g->tap[k + 1], x);
            store(d->tap[k] + i, s);
        }
        for (int k = 0; k < g->others; k++) {
            const ts_real *q = g->rest[k];
            lanes out = plus(zero(), (q[0] + q[1]) / (1 + q[2] + q[3]), x), older = plus(zero(), -q[3], out);
            store(d->rest[k][0] + i, plus(plus(older, q[1], x), -q[2], out));
            store(d->rest[k][1] + i, older);
        }
    }
}

/* y = sum of taps[i] q^-i x: each of the states t is a tick nearer to y than the next. */
static void pass_taps(const ts_real *taps, ts_real (*t)[TS_PADDED(TS_MAX_LEARNED)], const ts_real *x, ts_real *y, int m)
{
    ts_real tap[TS_TAPS]; /* which no store changes */
    memcpy(tap, taps, sizeof tap);
    for (int i = 0; i < m; i += TS_VECTOR) {
        ts_vector in = vector(x + i);
        *at(y + i) = *at(t[0] + i) + tap[0] * in;
        for (int k = 0; k < TS_TAPS - 2; k++) *at(t[k] + i) = *at(t[k + 1] + i) + tap[k + 1] * in;
        *at(t[TS_TAPS - 2] + i) = tap[TS_TAPS - 1] * in;
    }
}

/* y += (b0 + b1 q^-1) / (1 + a1 q^-1 + a2 q^-2) x, with the states t. */
static void pass_section(const ts_real *q, ts_real (*t)[TS_PADDED(TS_MAX_LEARNED)], const ts_real *x, ts_real *y, int m)
{
    ts_real b0 = q[0], b1 = q[1], a1 = q[2], a2 = q[3];
    for (int i = 0; i < m; i += TS_LANES) {
        lanes in = load(x + i), out = plus(load(t[0] + i), b0, in);
        store(t[0] + i, minus(plus(load(t[1] + i), b1, in), a1, out));
        store(t[1] + i, scaled(-a2, out));
        store(y + i, plus(load(y + i), 1, out));
    }
}

/* A G: the regressor as the measurement without the modes shows it, u; at rest before the first tick. */
void ts_pass_stage(ts_controller *c, ts_real *u)
{
    const ts_dynamics *g = dynamics_of(c);
    ts_dynamics_state *d = &c->dynamics;
    if (!d->started) rest_stage(c);
    d->started = true;
    d->stands = false;
    pass_taps(g->tap, d->tap, c->u, u, TS_PADDED(c->parameters));
    for (int k = 0; k < g->others; k++) pass_section(g->rest[k], d->rest[k], c->u, u, TS_PADDED(c->parameters));
}
