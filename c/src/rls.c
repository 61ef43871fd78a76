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
    r->trace = (ts_real)m / delta;
}

/* Bierman's U D: with P = U D U', f = U'u and g = D f, the columns of U are taken one after the other,
 *   alpha_j = alpha_(j-1) + f_j g_j,  U_j -= f_j / alpha_(j-1) b,  b += g_j U_j (the old one),  D_j *= alpha_(j-1) / alpha_j,
 * from alpha = lambda and b = 0; in the end alpha = lambda + u'P u and b = P u. The sum alpha is of squares, so that no
 * rounding can make D negative. */
bool ts_rls_update(ts_rls *r, ts_real *w, const ts_real *u, ts_real e, ts_real lambda, ts_real trace_limit, int m)
{
    enum { MOST = TS_PADDED(TS_MAX_PARAMETERS) };
    ts_real step[MOST], g[MOST], shrink[MOST], Pu[MOST], alpha = lambda, inverse = 1 / lambda;
    const ts_real *U = r->U;
    for (int j = 0; j < m; U += width(j), j++) {
        lanes parts = product(load(U), load(u));
        for (int i = TS_LANES; i < width(j); i += TS_LANES) parts = plus_product(parts, load(U + i), load(u + i));
        ts_real f = total(parts), before = alpha;
        g[j] = r->D[j] * f;
        step[j] = f * inverse;
        alpha += f * g[j];
        inverse = 1 / alpha;
        shrink[j] = before * inverse;
    }
    if (!isfinite(alpha) || !isfinite(e)) return false;

    ts_real growth = r->trace > lambda * trace_limit ? 1 : 1 / lambda, gain = e * inverse;
    for (int j = 0; j < m; j++) r->D[j] *= growth * shrink[j];
    lanes trace = zero();
    for (int i = 0; i < m; i += TS_LANES) { /* eight rows of U at a time, from their diagonal to the right */
        lanes b = zero(), diagonal = zero();
        ts_real *column = r->U + TS_ROW(i) + i;
        for (int j = i; j < m; column += width(j), j++) {
            ts_real step_j = step[j], g_j = g[j], D_j = r->D[j];
            for (int v = 0; v < TS_VECTORS; v++) {
                ts_vector old = vector(column + v * TS_VECTOR), new = old - step_j * b.v[v];
                *at(column + v * TS_VECTOR) = new;
                b.v[v] += g_j * old;
                diagonal.v[v] += D_j * (new * new);
            }
        }
        store(Pu + i, b);
        trace = plus(trace, 1, diagonal);
    }
    r->trace = total(trace);
    if (!isfinite(r->trace) || !isfinite(gain)) return false;
    move_weights(w, gain, Pu, m);
    return true;
}
