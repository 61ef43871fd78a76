#include "lanes.h"

#include <math.h>
#include <string.h>

void ts_rls_init(ts_rls *r, ts_real delta, int m)
{
    memset(r, 0, sizeof *r);
    for (int j = 0; j < m; j++) {
        r->U[TS_ROW(j) + j] = 1;
        r->D[j] = 1 / delta;
    }
}

ts_real ts_rls_trace(const ts_rls *r, int m)
{
    ts_real norms[TS_PADDED(TS_MAX_PARAMETERS)];
    for (int j = 0; j < m; j++) norms[j] = total(products(r->U + TS_ROW(j), r->U + TS_ROW(j), TS_PADDED(j + 1)));
    return dot(r->D, norms, m);
}

/* Whether the division by lambda would take trace P past its limit. In a tick the trace grows by 1 / lambda at most, and
 * by rounding: it is computed only where that bound has come near the limit. */
static bool at_limit(ts_rls *r, ts_real lambda, ts_real trace_limit, int m)
{
    ts_real most = lambda * trace_limit;
    if (!(r->trace_bound > 0 && r->trace_bound <= most)) r->trace_bound = ts_rls_trace(r, m);
    bool reached = r->trace_bound > most;
    r->trace_bound *= (1 + (ts_real)1e-5) / lambda;
    return reached;
}

/* Bierman's U D: with P = U D U', f = U'u and g = D f, the columns of U are taken one after the other,
 *   alpha_j = alpha_(j-1) + f_j g_j,  U_j -= f_j / alpha_(j-1) b,  b += g_j U_j (the old one),  D_j *= alpha_(j-1) / alpha_j,
 * from alpha = lambda and b = 0; in the end alpha = lambda + u'P u and b = P u. The sum alpha is of squares, so that no
 * rounding can make D negative. */
bool ts_rls_update(ts_rls *r, ts_real *w, const ts_real *u, ts_real e, ts_real lambda, ts_real trace_limit, int m)
{
    enum { MOST = TS_PADDED(TS_MAX_PARAMETERS) };
    ts_real step[MOST], g[MOST], shrink[MOST], alpha = lambda, inverse = 1 / lambda;
    const ts_real *U = r->U;
    for (int j = 0; j < m; U += width(j), j++) {
        ts_real f = total(products(U, u, width(j))), before = alpha;
        g[j] = r->D[j] * f;
        step[j] = f * inverse;
        alpha += f * g[j];
        inverse = 1 / alpha;
        shrink[j] = before * inverse;
    }
    if (!isfinite(alpha) || !isfinite(e)) return false;

    ts_real growth = at_limit(r, lambda, trace_limit, m) ? 1 : 1 / lambda, gain = e * inverse;
    for (int j = 0; j < m; j++) r->D[j] *= growth * shrink[j];
    for (int i = 0; i < m; i += TS_LANES) { /* eight rows of U at a time, from their diagonal to the right */
        lanes b = zero();
        ts_real *column = r->U + TS_ROW(i) + i;
        for (int j = i; j < m; column += width(j), j++) {
            lanes old = load(column);
            store(column, minus(old, step[j], b));
            b = plus(b, g[j], old);
        }
        store(w + i, plus(load(w + i), gain, b));
    }
    return true;
}
