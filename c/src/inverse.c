#include "lanes.h"

#define LEAST_SHARE ((ts_real)0.25) /* of a slope of the plays: with states of Duhem it is no less */

/* w.y with w[j] = s[j] - s[j-1], summed by parts: s[0] (y[0] - y[1]) + ... + s[n-1] y[n-1] */
ts_real ts_weighted_sum(const ts_real *s, const ts_real *y, int n)
{
    lanes sum = zero();
    int i = 0;
    for (; i + TS_LANES < n; i += TS_LANES)
        sum = plus_product(sum, load(s + i), difference(load(y + i), load(y + i + 1)));
    ts_real last[TS_LANES];
    store(last, sum);
    for (int l = 0; i + l < n; l++) last[l] += s[i + l] * (y[i + l] - (i + l + 1 < n ? y[i + l + 1] : 0));
    return total(load(last));
}

/* The slope behind play j, um/V, with what states of Duhem change it by: at least a quarter of that of the plays. */
static inline ts_real changed(const ts_real *s, int j, ts_real change)
{
    ts_real sum = s[j] + change, least = LEAST_SHARE * s[j];
    return sum < least ? least : sum;
}

ts_real ts_play_walk(ts_real gap, const ts_real *s, ts_real change, const ts_real *r, const ts_real *y, int n)
{
    ts_real sign = gap < 0 ? (ts_real)-1 : (ts_real)1;
    ts_real x = y[0]; /* r[0] = 0: the state of the first play is the last voltage */
    int j = 0;
    for (; j + 1 < n; j++) { /* from breakpoint to breakpoint, where play j + 1 begins to move */
        ts_real breakpoint = y[j + 1] + sign * r[j + 1];
        ts_real next = gap - changed(s, j, change) * (breakpoint - x);
        if (next * sign <= 0) break;
        gap = next;
        x = breakpoint;
    }
    return x + gap / changed(s, j, change);
}

ts_real ts_play_inverse(ts_real y_d, const ts_real *s, const ts_real *r, const ts_real *y, int n)
{
    return ts_play_walk(y_d - ts_weighted_sum(s, y, n), s, 0, r, y, n);
}
