/* Compiled for the processor that it runs on (-march=native). */
#include "probe.h"

#include "../src/lanes.h"

enum { CHAINS = 2 }; /* sums that do not wait for each other */

void ts_probe_rls(ts_rls *r, ts_real *w, const ts_real *u, int m)
{
    lanes f[CHAINS], b[CHAINS], trace[CHAINS], first = load(u);
    for (int q = 0; q < CHAINS; q++) f[q] = b[q] = trace[q] = zero();
    int n = TS_TRIANGLE(m) / (CHAINS * TS_LANES) * (CHAINS * TS_LANES);
    for (int k = 0; k < n; k += CHAINS * TS_LANES) /* f = U'u */
        for (int q = 0; q < CHAINS; q++) f[q] = plus_product(f[q], load(r->U + k + q * TS_LANES), first);
    for (int k = 0; k < n; k += CHAINS * TS_LANES) /* U, b and the trace */
        for (int q = 0; q < CHAINS; q++) {
            lanes old = load(r->U + k + q * TS_LANES), new = minus(old, (ts_real)1e-6, first);
            store(r->U + k + q * TS_LANES, new);
            b[q] = plus(b[q], (ts_real)1e-6, old);
            trace[q] = plus(trace[q], (ts_real)1e-6, product(new, new));
        }
    for (int q = 1; q < CHAINS; q++) b[0] = plus(b[0], 1, plus(f[q], 1, plus(b[q], 1, trace[q])));
    b[0] = plus(b[0], 1, plus(f[0], 1, trace[0]));
    for (int i = 0; i < m; i += TS_LANES) store(w + i, plus(load(w + i), (ts_real)1e-6, b[0]));
}
