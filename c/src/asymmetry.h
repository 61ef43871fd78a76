/* Asymmetry: its terms, and the displacement whose asymmetry they are. */
#ifndef TS_ASYMMETRY_H
#define TS_ASYMMETRY_H

#include "truestroke.h"

enum { TS_NEWTON_STEPS = 8 }; /* at most */

/* 4 s (1 - s) and 8 s (1 - s)(1 - 2 s), of s = z / stroke within -1 <= s <= 2: further out a polynomial is meaningless, and would overflow. */
static inline void ts_asymmetry_terms(ts_real s, ts_real *term)
{
    term[0] = 4 * s * (1 - s);
    term[1] = 2 * term[0] * (1 - 2 * s);
}

/* Their derivatives by s. */
static inline void ts_asymmetry_slopes(ts_real s, ts_real *slope)
{
    slope[0] = 4 - 8 * s;
    slope[1] = 8 * (1 - 6 * s + 6 * s * s);
}

/* The z with z - w.terms(z) = y, um, of n weights, by Newton's method from y on. */
static inline ts_real ts_with_asymmetry(const ts_real *w, int n, ts_real stroke, ts_real y)
{
    const ts_real converged = (ts_real)1e-13 * stroke, steep = (ts_real)0.1; /* a step that is smaller is the last; the least slope */
    ts_real z = y, term[TS_MAX_ASYMMETRY], slope[TS_MAX_ASYMMETRY];
    for (int i = 0; n > 0 && i < TS_NEWTON_STEPS; i++) {
        ts_real whole = z / stroke, s = whole < -1 ? -1 : whole > 2 ? 2 : whole, sum = 0, rise = 0;
        ts_asymmetry_terms(s, term);
        ts_asymmetry_slopes(s, slope);
        for (int k = 0; k < n; k++) {
            sum += w[k] * term[k];
            if (s == whole) rise += w[k] * (slope[k] / stroke);
        }
        ts_real step = (z - sum - y) / (1 - rise > steep ? 1 - rise : steep);
        z -= step;
        if (step <= converged && step >= -converged) break;
    }
    return z;
}

#endif
