#include "truestroke.h"

ts_real ts_play_inverse(ts_real y_d, const ts_real *s, const ts_real *r, const ts_real *y, int n)
{
    ts_real gap = y_d; /* what is still missing at x, um: y_d - w.y, with w[j] = s[j] - s[j-1] summed by parts */
    for (int j = 0; j + 1 < n; j++) gap -= s[j] * (y[j] - y[j + 1]);
    gap -= s[n - 1] * y[n - 1];

    ts_real sign = gap < 0 ? (ts_real)-1 : (ts_real)1;
    ts_real x = y[0]; /* r[0] = 0: the state of the first play is the last voltage */
    int j = 0;
    for (; j + 1 < n; j++) { /* from breakpoint to breakpoint, where play j + 1 begins to move */
        ts_real breakpoint = y[j + 1] + sign * r[j + 1];
        ts_real next = gap - s[j] * (breakpoint - x);
        if (next * sign <= 0) break;
        gap = next;
        x = breakpoint;
    }
    return x + gap / s[j];
}
