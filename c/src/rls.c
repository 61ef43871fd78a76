#include "truestroke.h"

#include <math.h>

/* Potter's square root: with P = S S', f = S'u, a = lambda + f'f, (23) is mu = S f / a and
 * S' = (S - S f f' / (a + sqrt(lambda a))) / sqrt(lambda). S S' cannot lose its definiteness, whatever is rounded. */
bool ts_rls_update(ts_real *w, ts_real *S, ts_real *f, const ts_real *u, ts_real e, ts_real lambda,
                   ts_real trace_limit, int m)
{
    ts_real f_f = 0, trace = 0;
    for (int j = 0; j < m; j++) f[j] = 0;
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++) {
            f[j] += S[i * m + j] * u[i];
            trace += S[i * m + j] * S[i * m + j];
        }
    for (int j = 0; j < m; j++) f_f += f[j] * f[j];
    if (!isfinite(f_f) || !isfinite(e)) return false;

    ts_real a = lambda + f_f;
    ts_real shrink = 1 / (a + (ts_real)sqrt(lambda * a));
    ts_real growth = trace > lambda * trace_limit ? 1 : 1 / (ts_real)sqrt(lambda);
    for (int i = 0; i < m; i++) {
        ts_real pi = 0;
        for (int j = 0; j < m; j++) pi += S[i * m + j] * f[j];
        w[i] += pi / a * e;
        for (int j = 0; j < m; j++) S[i * m + j] = growth * (S[i * m + j] - shrink * pi * f[j]);
    }
    return true;
}
