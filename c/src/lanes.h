/* Eight lanes: the one order in which the kernel sums, on every machine.
 *
 * A sum of products runs in TS_LANES interleaved sums, which are then added in halves. Each lane is a chain of its own, so
 * vectors of 2, 4 or 8 numbers, and no vectors at all, round alike: every build gives the same bits.
 */
#ifndef TRUESTROKE_LANES_H
#define TRUESTROKE_LANES_H

#include <math.h>
#include <string.h>

#include "truestroke.h"

#if defined(__SSE2__) || defined(__ARM_NEON) || defined(__wasm_simd128__) || defined(__VSX__)
#define TS_HAS_VECTORS
#endif

#if !defined(__GNUC__) || !defined(TS_HAS_VECTORS) || defined(TS_PLAIN)
typedef ts_real ts_vector; /* plain C99; on a machine without vectors faster than vectors that the compiler takes apart */
#else
#if defined(__AVX__)
#define TS_VECTOR_BYTES 32
#else
#define TS_VECTOR_BYTES 16
#endif
#define TS_LANES_BYTES (TS_LANES * sizeof(ts_real))
typedef ts_real ts_vector __attribute__((
    vector_size(TS_VECTOR_BYTES < TS_LANES_BYTES ? TS_VECTOR_BYTES : TS_LANES_BYTES), aligned(sizeof(ts_real)), may_alias));
#endif

/* The loops over the lanes are unrolled, as gcc does by itself from -O3 on: the lanes then stay in registers. */
#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ >= 8
#define TS_UNROLLED _Pragma("GCC unroll 8")
#define TS_UNROLLED_WHOLE _Pragma("GCC unroll 16") /* a longer loop, of known length */
#else
#define TS_UNROLLED
#define TS_UNROLLED_WHOLE
#endif

enum { TS_VECTOR = sizeof(ts_vector) / sizeof(ts_real), TS_VECTORS = TS_LANES / TS_VECTOR };
typedef struct { ts_vector v[TS_VECTORS]; } lanes;

/* The vector that begins at a. */
static inline ts_vector *at(ts_real *a) { return (ts_vector *)a; }
static inline ts_vector vector(const ts_real *a) { return *(const ts_vector *)a; }

static inline lanes load(const ts_real *a)
{
    lanes x;
    TS_UNROLLED
    for (int i = 0; i < TS_VECTORS; i++) x.v[i] = vector(a + i * TS_VECTOR);
    return x;
}

static inline void store(ts_real *a, lanes x)
{
    TS_UNROLLED
    for (int i = 0; i < TS_VECTORS; i++) *at(a + i * TS_VECTOR) = x.v[i];
}

/* The square root, of a float without double arithmetic: both round alike. */
static inline ts_real root_of(ts_real x)
{
    return sizeof(ts_real) > 4 ? (ts_real)sqrt((double)x) : (ts_real)sqrtf((float)x);
}

static inline ts_real size_of(ts_real x)
{
    return x < 0 ? -x : x;
}

static inline lanes zero(void)
{
    return (lanes){0};
}

/* factor a, x + factor a, x - factor a, x + a b, a b, x - a */
static inline lanes scaled(ts_real factor, lanes a)
{
    TS_UNROLLED
    for (int i = 0; i < TS_VECTORS; i++) a.v[i] *= factor;
    return a;
}

static inline lanes plus(lanes x, ts_real factor, lanes a)
{
    TS_UNROLLED
    for (int i = 0; i < TS_VECTORS; i++) x.v[i] += factor * a.v[i];
    return x;
}

static inline lanes minus(lanes x, ts_real factor, lanes a)
{
    TS_UNROLLED
    for (int i = 0; i < TS_VECTORS; i++) x.v[i] -= factor * a.v[i];
    return x;
}

static inline lanes plus_product(lanes x, lanes a, lanes b)
{
    TS_UNROLLED
    for (int i = 0; i < TS_VECTORS; i++) x.v[i] += a.v[i] * b.v[i];
    return x;
}

static inline lanes product(lanes a, lanes b)
{
    TS_UNROLLED
    for (int i = 0; i < TS_VECTORS; i++) a.v[i] *= b.v[i];
    return a;
}

static inline lanes difference(lanes x, lanes a)
{
    TS_UNROLLED
    for (int i = 0; i < TS_VECTORS; i++) x.v[i] -= a.v[i];
    return x;
}

/* Entries of row i of a triangle: TS_ROW(i + 1) - TS_ROW(i). A loop over the rows adds them up, which is faster. */
static inline int width(int i)
{
    return (int)(((unsigned)i / TS_LANES + 1) * TS_LANES);
}

/* The lanes added in halves: 0 + 4, 1 + 5, 2 + 6, 3 + 7; then 0 + 2, 1 + 3; then 0 + 1. */
static inline ts_real total(lanes x)
{
    ts_real s[TS_VECTOR];
    TS_UNROLLED
    for (int half = TS_VECTORS / 2; half > 0; half /= 2)
        TS_UNROLLED
        for (int i = 0; i < half; i++) x.v[i] += x.v[i + half];
    memcpy(s, &x.v[0], sizeof s);
    TS_UNROLLED
    for (int half = TS_VECTOR / 2; half > 0; half /= 2)
        TS_UNROLLED
        for (int i = 0; i < half; i++) s[i] += s[i + half];
    return s[0];
}

/* a.b of n numbers: whole blocks of lanes, n a multiple of TS_LANES; or any n. */
static inline lanes products(const ts_real *a, const ts_real *b, int n)
{
    lanes sum = zero();
    for (int i = 0; i < n; i += TS_LANES) sum = plus_product(sum, load(a + i), load(b + i));
    return sum;
}

/* w += step a; weights stay within TS_LARGEST. w and a have whole blocks of lanes. */
static inline void move_weights(ts_real *w, ts_real step, const ts_real *a, int m)
{
    lanes squares = zero();
    for (int i = 0; i < m; i += TS_LANES) {
        lanes x = plus(load(w + i), step, load(a + i));
        store(w + i, x);
        squares = plus_product(squares, x, x);
    }
    if (total(squares) <= TS_LARGEST) return;
    for (int i = 0; i < m; i++) w[i] = w[i] > TS_LARGEST ? TS_LARGEST : w[i] < -TS_LARGEST ? -TS_LARGEST : w[i];
}

static inline ts_real dot(const ts_real *a, const ts_real *b, int n)
{
    int whole = n - n % TS_LANES;
    lanes sum = products(a, b, whole);
    if (whole == n) return total(sum);
    ts_real last[TS_LANES];
    store(last, sum);
    for (int i = whole; i < n; i++) last[i - whole] += a[i] * b[i];
    return total(load(last));
}

#endif
