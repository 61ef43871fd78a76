/* The simulated stack as the unit of an FMU. Its noise is of a generator of its own, from the parameter `seed`. */
#include <math.h>

#include "unit.h"

enum { VOLTS, MEASURED, TRUTH, SEED, PARAMETERS };

/* splitmix64 (Steele, Lea, Flood 2014), as a number above 0 and up to 1. */
static double uniform(uint64_t *state)
{
    uint64_t x = *state += 0x9e3779b97f4a7c15u;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return (double)(((x ^ (x >> 31)) >> 11) + 1) * 0x1p-53;
}

/* Standard normal (Box and Muller 1958). */
static double normal(uint64_t *state)
{
    double size = sqrt(-2 * log(uniform(state)));
    return size * cos(6.283185307179586 * uniform(state));
}

bool fmu_begin(fmu_state *s, char *said)
{
    (void)said;
    ts_plant_settings settings = fmu_settings;
    const double *v = s->value + PARAMETERS;
#define PARAMETER(name) settings.name = *v++;
    FMU_PARAMETERS
#undef PARAMETER
    s->unit.random = (uint64_t)s->value[SEED];
    ts_plant_init(&s->unit.plant, &settings);
    return true;
}

bool fmu_tick(fmu_state *s, int i, int of, char *said)
{
    (void)i, (void)of;
    double volts = s->value[VOLTS], noise[FMU_SAMPLES];
    if (!fmu_is_finite(s, VOLTS, said)) return false;
    for (int k = 0; k < s->unit.plant.settings.samples_per_tick; k++) noise[k] = normal(&s->unit.random);
    ts_plant_run(&s->unit.plant, &volts, noise, &s->value[MEASURED], &s->value[TRUTH], 1);
    return true;
}

void fmu_moved(fmu_state *s)
{
    (void)s;
}
