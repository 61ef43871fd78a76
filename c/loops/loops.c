#include "loops.h"

#include <math.h>

enum { REJECTED = 4, FROM_ADAPT = REJECTED | 16 }; /* of the flag bits, those that adapt sets; command sets the others */

void ts_loop_run(const ts_loop_controller *c, const ts_loop_actuator *a, const ts_loop_channels *ch, size_t ticks)
{
    for (size_t k = 0; k < ticks; k++) {
        ch->volts[k] = c->command(c->self, ch->z_d[k], ch->zdot_d[k]);
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
    double re = 0, im = 0;
    for (size_t k = 0; k < ticks; k++) {
        x[2 * k] = re;
        x[2 * k + 1] = im;
        if (k + 1 == ticks) return;
        double next = (decay[0] * re - decay[1] * im) + u[2 * k];
        im = (decay[0] * im + decay[1] * re) + u[2 * k + 1];
        re = next;
    }
}
