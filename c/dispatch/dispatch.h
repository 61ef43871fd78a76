/* The kernel for several instruction sets in one library, chosen at run time: for binaries that are compiled for other
 * computers.
 *
 * The kernel (c/src) is compiled several times, each as a variant of its own (variant.c); dispatch.c defines the functions
 * of truestroke.h, which call the variant in use. All variants give the same bits, since sums run in lanes. The choice is
 * the only global state: make it before the first thread. A microcontroller needs none of this and compiles c/src.
 */
#ifndef TRUESTROKE_DISPATCH_H
#define TRUESTROKE_DISPATCH_H

#include "truestroke.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Names of the variants that this processor runs, from "plain" (C99 without vectors) to the fastest; NULL past the end. */
const char *ts_variant_name(int i);

/* Uses the variant of that name; NULL: the fastest. False, and no change, where there is none. */
bool ts_variant_use(const char *name);

const char *ts_variant_in_use(void);

#ifdef __cplusplus
}
#endif

/* The functions of truestroke.h that the package calls: result, name, parameters, arguments; apart are those that return nothing. The
 * others are called by the kernel itself alone. */
#define TS_FUNCTIONS(VALUE, NOTHING)                                                                                    \
    NOTHING(ts_play_bank, (ts_real x, const ts_real *r, ts_real *y, int n), (x, r, y, n))                               \
    VALUE(ts_real, ts_dead_zones, (ts_real y, const ts_real *d, const ts_real *w, int m), (y, d, w, m))                 \
    VALUE(ts_real, ts_dot, (const ts_real *a, const ts_real *b, int n), (a, b, n))                                      \
    VALUE(ts_real, ts_weighted_sum, (const ts_real *s, const ts_real *y, int n), (s, y, n))                                  \
    VALUE(ts_real, ts_play_inverse, (ts_real y_d, const ts_real *s, const ts_real *r, const ts_real *y, int n),         \
          (y_d, s, r, y, n))                                                                                            \
    NOTHING(ts_rls_init, (ts_rls *r, ts_real delta, int m), (r, delta, m))                                              \
    VALUE(bool, ts_rls_update, (ts_rls *r, ts_real *w, const ts_real *u, ts_real e, ts_real lambda, ts_real limit,      \
          int m), (r, w, u, e, lambda, limit, m))                                                                       \
    NOTHING(ts_kalman_init, (ts_kalman *k, ts_prior P0, ts_real sigma, int m), (k, P0, sigma, m))                       \
    VALUE(bool, ts_kalman_is_spike, (ts_kalman *k, const ts_kalman_settings *s, ts_real innovation, ts_real noisy, bool smooth), \
          (k, s, innovation, noisy, smooth)) \
    VALUE(bool, ts_kalman_tick, (ts_kalman *k, const ts_kalman_settings *s, const ts_real *w0, ts_prior P0,             \
          ts_real *w, const ts_real *u, ts_real y, ts_real innovation, bool measured, bool learn, int m),               \
          (k, s, w0, P0, w, u, y, innovation, measured, learn, m))                                                      \
    NOTHING(ts_kalman_project, (const ts_kalman *k, ts_real *w, ts_column_sums *sums, int columns, ts_real rate,        \
            ts_real missing, int m), (k, w, sums, columns, rate, missing, m))                                           \
    VALUE(int, ts_parameters, (const ts_settings *s), (s))                                                              \
    VALUE(ts_status, ts_controller_init, (ts_controller *c, const ts_settings *s), (c, s))                              \
    NOTHING(ts_controller_reset, (ts_controller *c), (c))                                                               \
    VALUE(ts_real, ts_reach, (const ts_settings *s, ts_real volts), (s, volts))                                         \
    VALUE(ts_status, ts_controller_start, (ts_controller *c, ts_real volts, ts_real z), (c, volts, z))                  \
    VALUE(ts_status, ts_controller_change, (ts_controller *c, const ts_settings *s), (c, s))                            \
    VALUE(ts_status, ts_controller_command, (ts_controller *c, ts_real z_d, ts_real zdot_d, ts_real *volts),            \
          (c, z_d, zdot_d, volts))                                                                                      \
    VALUE(ts_status, ts_controller_follow, (ts_controller *c, ts_real z_d, ts_real zdot_d, ts_real zddot_d,             \
          ts_real strain_d, const ts_real *others, ts_real *volts), (c, z_d, zdot_d, zddot_d, strain_d, others, volts)) \
    VALUE(ts_status, ts_controller_adapt, (ts_controller *c, ts_real z, int ago), (c, z, ago))                          \
    NOTHING(ts_controller_hold, (ts_controller *c, bool hold), (c, hold))                                               \
    NOTHING(ts_controller_complete, (ts_controller *c), (c))                                                            \
    VALUE(bool, ts_repetition_init, (ts_repetition *r, const ts_repetition_settings *s, ts_real *memory), (r, s, memory)) \
    VALUE(bool, ts_repetition_tick, (ts_repetition *r, ts_real z_d), (r, z_d))                                          \
    NOTHING(ts_repetition_trigger, (ts_repetition *r), (r))                                                             \
    NOTHING(ts_repetition_leave, (ts_repetition *r), (r))                                                               \
    VALUE(bool, ts_repetition_become, (ts_repetition *r, const ts_real *volts, ts_real scale, int waits),               \
          (r, volts, scale, waits))                                                                                     \
    VALUE(int, ts_repetition_free, (const ts_repetition *r), (r))                                                       \
    NOTHING(ts_repetition_move, (ts_repetition *r, ts_real volts, ts_real ticks), (r, volts, ticks))                    \
    VALUE(ts_real, ts_repetition_volts, (ts_repetition *r, ts_real inside, ts_real low, ts_real high, ts_real slew),    \
          (r, inside, low, high, slew))                                                                                 \
    VALUE(bool, ts_repetition_see, (ts_repetition *r, ts_real error, ts_real gain), (r, error, gain))

#define TS_VALUE_MEMBER(type, name, parameters, arguments) type(*name) parameters;
#define TS_NOTHING_MEMBER(name, parameters, arguments) void(*name) parameters;
typedef struct {
    const char *name;
    TS_FUNCTIONS(TS_VALUE_MEMBER, TS_NOTHING_MEMBER)
} ts_variant;

#endif
