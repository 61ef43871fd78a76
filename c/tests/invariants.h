/* What holds of a controller's state whatever came: for the tests and for the fuzzer. */
#ifndef TRUESTROKE_INVARIANTS_H
#define TRUESTROKE_INVARIANTS_H

#include <math.h>
#include <stddef.h>

#include "truestroke.h"

static inline bool all_finite(const ts_real *a, int n)
{
    bool ok = true;
    for (int i = 0; i < n; i++) ok &= isfinite(a[i]) != 0;
    return ok;
}

static inline bool finite_memory(const ts_memory *memory, const ts_settings *s)
{
    return all_finite(memory->play, s->plays) && all_finite(memory->creep, s->terms[TS_CREEP]) && all_finite(memory->duhem, s->terms[TS_DUHEM]);
}

static inline bool finite_law(const ts_controller *c)
{
    int m = c->parameters;
    if (c->settings->law == TS_LAW_RLS) {
        const ts_rls *r = &c->law.rls;
        return all_finite(r->U, TS_TRIANGLE(m)) && all_finite(r->D, m) && isfinite(r->trace);
    }
    const ts_kalman *k = &c->law.kalman;
    const ts_oscillation *o = &c->oscillation;
    const ts_stage *g = &c->stage;
    const ts_guard *w = &c->guard;
    const ts_resonance *f = &c->resonance;
    if (!all_finite(&f->centre, offsetof(ts_resonance, settling) / sizeof(ts_real)) || !all_finite(c->shown, TS_SHOWN) || !isfinite(c->rate)) return false;
    const ts_real scalars[] = {w->low, w->high, w->errors.sum, w->errors.square, w->errors.first, w->missed.sum, w->missed.square, w->promised, w->entered, w->error, w->best, w->failed, w->drift, w->span, w->swing, w->swung, c->kept.sigma, c->kept.filter,
                               c->kept.smoothing, c->kept.resonance, c->kept.inertia, c->kept.watch.recall.low, c->kept.watch.recall.missed.square,
                               k->caution, k->y1, k->y, k->variance, k->sigma, k->ringing, k->innovation1, k->innovation2, k->change,
                               k->filter, k->disturbance, o->fast, o->slow, o->slower, o->speed, o->acceleration, o->zdot_d,
                               o->error, o->h, o->peak, o->steepest, g->resonance, g->inertia, g->smoothing, g->rest, g->age};
    if (!all_finite(c->kept.w, m) || !all_finite(c->kept.aside, m) || !all_finite(c->kept.P, TS_PACKED(m))) return false;
    if (!all_finite(o->peaks, TS_HALF_WAVES) || !all_finite(g->newer, m) || !all_finite(g->before.older, m)) return false;
    return all_finite(k->P, TS_TRIANGLE(m)) && all_finite(k->u1, m) && all_finite(k->u, m) && all_finite(k->Pu, m)
           && all_finite(scalars, sizeof scalars / sizeof *scalars);
}

static inline bool finite_stage(const ts_controller *c)
{
    const ts_dynamics_state *d = &c->dynamics;
    bool ok = isfinite(c->feedback.sum) && isfinite(c->feedback.alarms) && all_finite(&c->feedback.state[0][0], 2 * TS_FEEDBACKS);
    ok = ok && all_finite(c->feedback.damping, 5) && all_finite(c->feedback.damped, 2) && all_finite(&c->feedback.side, 3);
    ok = ok && all_finite(c->sensor.before, c->parameters) && all_finite(c->sensor.lagged, c->parameters);
    for (int i = 0; i < TS_TAPS - 1; i++) ok &= all_finite(d->tap[i], c->parameters);
    for (int i = 0; i < 2 * TS_SECTIONS; i++) ok &= all_finite(d->rest[i / 2][i % 2], c->parameters);
    return ok && all_finite(&d->section[0][0], 2 * TS_SECTIONS) && all_finite(&d->mode[0][0], 2 * TS_SECTIONS) && all_finite(d->strain, TS_HISTORY) && all_finite(d->z, 2);
}

static inline bool finite_state(const ts_controller *c)
{
    const ts_settings *s = c->settings;
    const ts_real scalars[] = {c->bumpless, c->handed, c->integral, c->y_d, c->fastest, c->innovation, c->z_before,
                               c->predicted_before, c->resolution};
    return all_finite(scalars, sizeof scalars / sizeof *scalars) && all_finite(c->w, TS_PADDED(c->parameters))
           && all_finite(c->u, c->parameters) && all_finite(c->slopes, s->plays) && all_finite(c->x, TS_HISTORY)
           && all_finite(&c->motion[0].z_d, TS_HISTORY * sizeof(ts_motion) / sizeof(ts_real)) && finite_memory(&c->now, s)
           && finite_memory(&c->lagged, s) && finite_law(c) && finite_stage(c);
}

/* Of a repetition whose desired values and tables are finite. */
static inline bool sound(const ts_repetition *r)
{
    const ts_real scalars[] = {r->value, r->offset, r->drift, r->error, r->own, r->slope, r->square, r->first, r->sum, r->squares,
                               r->low, r->high, r->slopes, r->level, r->goal, r->climb, r->errors, r->kept, r->last,
                               r->added[0].from, r->added[0].to, r->added[1].from, r->added[1].to};
    bool paced = r->pace > 0 && r->step > 0 && r->step < 2 && r->part >= 0 && r->part < 1 && r->place >= 0 && r->place < r->settings->size;
    bool known = r->shape.wave != NULL || !r->repeats;
    return paced && known && (r->repeats || !r->aligned) && (r->aligned || !r->joined) && (r->corrects || !r->joined) && r->amplitude > 0
           && r->changed >= 0 && r->changed <= 1 && r->counted < r->settings->size && r->waits >= 0
           && all_finite(scalars, sizeof scalars / sizeof *scalars) && all_finite(r->fundamental, 2) && all_finite(r->turned, 2);
}

/* Whether P is positive definite: its Cholesky factor exists. */
static inline bool definite(const ts_real *P, int m)
{
    static double L[TS_MAX_PARAMETERS][TS_MAX_PARAMETERS];
    for (int i = 0; i < m; i++)
        for (int j = 0; j <= i; j++) {
            double sum = P[TS_ROW(i) + j];
            for (int k = 0; k < j; k++) sum -= L[i][k] * L[j][k];
            if (i == j && !(sum > 0)) return false;
            L[i][j] = i == j ? sqrt(sum) : sum / L[j][j];
        }
    return true;
}

/* P of the bounded law is stored twice within its blocks on the diagonal: both to the same bit. */
static inline bool symmetric(const ts_real *P, int m)
{
    bool same = true;
    for (int i = 0; i < m; i++)
        for (int j = i - i % TS_LANES; j < i; j++)
            same &= !(P[TS_ROW(j) + i] < P[TS_ROW(i) + j] || P[TS_ROW(j) + i] > P[TS_ROW(i) + j]);
    return same;
}

#endif
