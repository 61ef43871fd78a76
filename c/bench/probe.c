/* Compiled for the processor that it runs on (-march=native). */
#include "probe.h"

#include "../src/lanes.h"

void ts_probe_rls(ts_rls *r, ts_real *w, const ts_real *u, int m)
{
    lanes sum[4] = {zero(), zero(), zero(), zero()}, first = load(u);
    int n = TS_TRIANGLE(m), k = 0;
    for (; k + 4 * TS_LANES <= n; k += 4 * TS_LANES) /* f = U'u */
        for (int q = 0; q < 4; q++) sum[q] = plus_product(sum[q], load(r->U + k + q * TS_LANES), first);
    for (; k < n; k += TS_LANES) sum[0] = plus_product(sum[0], load(r->U + k), first);
    ts_real g = (ts_real)1e-30;
    for (k = 0; k + 4 * TS_LANES <= n; k += 4 * TS_LANES) /* U and b */
        for (int q = 0; q < 4; q++) {
            lanes old = load(r->U + k + q * TS_LANES);
            store(r->U + k + q * TS_LANES, minus(old, g, first));
            sum[q] = plus(sum[q], g, old);
        }
    for (; k < n; k += TS_LANES) {
        lanes old = load(r->U + k);
        store(r->U + k, minus(old, g, first));
        sum[0] = plus(sum[0], g, old);
    }
    for (int q = 1; q < 4; q++) sum[0] = plus(sum[0], 1, sum[q]);
    for (int i = 0; i < m; i += TS_LANES) store(w + i, plus(load(w + i), g, sum[0]));
}
