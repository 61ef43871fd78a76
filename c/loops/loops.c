#include "loops.h"

#include <math.h>

enum { REJECTED = 4, FROM_ADAPT = REJECTED | 16 | 64 | 128 }; /* of the flag bits, those that adapt sets; command sets the others */

/* After adapt: the flags of both calls, and the innovation. */
static void note(const ts_loop_controller *c, unsigned commanded, uint8_t *flags, double *innovation)
{
    unsigned adapted = c->flags(c->self);
    *flags = (uint8_t)((commanded & ~(unsigned)FROM_ADAPT) | (adapted & FROM_ADAPT));
    *innovation = adapted & REJECTED ? NAN : c->innovation(c->self);
}

void ts_loop_run(const ts_loop_controller *c, const ts_loop_actuator *a, const ts_loop_channels *ch, size_t ticks)
{
    for (size_t k = 0; k < ticks; k++) {
        double motion[4] = {ch->z_d[k], ch->zdot_d[k], ch->zddot_d ? ch->zddot_d[k] : NAN, ch->strain_d ? ch->strain_d[k] : NAN};
        ch->volts[k] = c->command(c->self, motion, NULL);
        unsigned commanded = c->flags(c->self);
        a->exchange(a->self, ch->volts[k], ch->zdot_d[k], ch->noise + k * a->noise_per_tick, &ch->measured[k],
                    &ch->truth[k]);
        c->adapt(c->self, ch->measured[k]);
        note(c, commanded, &ch->flags[k], &ch->innovation[k]);
    }
}

void ts_loop_run_axes(const ts_loop_controller *c, const ts_loop_axes *a, const ts_loop_axes_channels *ch, size_t ticks)
{
    const size_t n = a->axes;
    unsigned commanded[TS_LOOP_MAX_AXES];
    for (size_t k = 0; k < ticks; k++) {
        for (size_t i = 0, at = k * n; i < n; i++, at++) {
            const double *d = ch->motion + 3 * at, motion[4] = {d[0], d[1], d[2], ch->strain_d[at]};
            ch->volts[at] = c[i].command(c[i].self, motion, ch->others + 3 * (n - 1) * at);
            commanded[i] = c[i].flags(c[i].self);
        }
        const double *measured = ch->measured + k * n;
        a->exchange(a->self, ch->volts + k * n, ch->noise + k * a->noise_per_tick, ch->measured + k * n, ch->truth + k * n);
        for (size_t i = 0, at = k * n; i < n; i++, at++) {
            double z = 0;
            for (size_t j = 0; j < n; j++) z += ch->to_axes[n * i + j] * measured[j];
            c[i].adapt(c[i].self, z);
            note(&c[i], commanded[i], &ch->flags[at], &ch->innovation[at]);
        }
    }
}

void ts_first_order(const double decay[2], const double *u, double *x, size_t ticks)
{
    for (size_t k = 0; k < 2 * ticks; k += 2) {
        x[k + 2] = (decay[0] * x[k] - decay[1] * x[k + 1]) + u[k];
        x[k + 3] = (decay[0] * x[k + 1] + decay[1] * x[k]) + u[k + 1];
    }
}
