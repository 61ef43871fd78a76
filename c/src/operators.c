#include "lanes.h"

void ts_play_bank(ts_real x, const ts_real *r, ts_real *y, int n)
{
    for (int i = 0; i < n; i++) {
        ts_real low = x - r[i], high = x + r[i];
        ts_real inner = y[i] < high ? y[i] : high;
        y[i] = inner > low ? inner : low;
    }
}

ts_real ts_dead_zones(ts_real y, const ts_real *d, const ts_real *w, int m)
{
    ts_real sum[TS_LANES] = {w[0] * y};
    if (m == 1) return sum[0];
    for (int i = 1; i < m; i++)
        if (y > d[i]) sum[i % TS_LANES] += w[i] * (y - d[i]);
    return total(load(sum));
}

ts_real ts_dot(const ts_real *a, const ts_real *b, int n)
{
    return dot(a, b, n);
}
