#include "loops.h"

#include <math.h>

enum { REJECTED = 4, FROM_ADAPT = REJECTED | 16 | 64 | 128 }; /* of the flag bits, those that adapt sets; command sets the others */

void ts_loop_run(const ts_loop_controller *c, const ts_loop_actuator *a, const ts_loop_channels *ch, size_t ticks)
{
    for (size_t k = 0; k < ticks; k++) {
        double motion[4] = {ch->z_d[k], ch->zdot_d[k], ch->zddot_d ? ch->zddot_d[k] : NAN, ch->strain_d ? ch->strain_d[k] : NAN};
        ch->volts[k] = c->command(c->self, motion);
        unsigned commanded = c->flags(c->self);
        a->exchange(a->self, ch->volts[k], ch->zdot_d[k], ch->noise + k * a->noise_per_tick, &ch->measured[k],
                    &ch->truth[k]);
        c->adapt(c->self, ch->measured[k]);
        unsigned adapted = c->flags(c->self);
        ch->flags[k] = (uint8_t)((commanded & ~(unsigned)FROM_ADAPT) | (adapted & FROM_ADAPT));
        ch->innovation[k] = adapted & REJECTED ? NAN : c->innovation(c->self);
    }
}

void ts_first_order(const double decay[2], const double *u, double *x, size_t ticks)
{
    for (size_t k = 0; k < 2 * ticks; k += 2) {
        x[k + 2] = (decay[0] * x[k] - decay[1] * x[k + 1]) + u[k];
        x[k + 3] = (decay[0] * x[k + 1] + decay[1] * x[k]) + u[k + 1];
    }
}
