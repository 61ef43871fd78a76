#include "truestroke.h"

#include <math.h>

bool ts_rls_update(ts_real *w, ts_real *P, ts_real *pi, const ts_real *u, ts_real e, ts_real lambda,
                   ts_real trace_limit, int m)
{
    ts_real u_pi = 0, trace = 0;
    for (int i = 0; i < m; i++) {
        ts_real sum = 0;
        for (int j = 0; j < m; j++) sum += P[i * m + j] * u[j];
        pi[i] = sum;
        u_pi += u[i] * sum;
        trace += P[i * m + i];
    }
    if (!(u_pi >= 0) || !isfinite(u_pi) || !isfinite(e)) return false;

    ts_real gain = 1 / (lambda + u_pi);
    ts_real growth = trace > lambda * trace_limit ? 1 : 1 / lambda;
    for (int i = 0; i < m; i++) {
        ts_real mu = gain * pi[i];
        w[i] += mu * e;
        for (int j = 0; j <= i; j++) P[j * m + i] = P[i * m + j] = growth * (P[i * m + j] - mu * pi[j]);
    }
    return true;
}
