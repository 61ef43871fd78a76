/* The terms of the model: the plays with their rates, and those that are known before the voltage is chosen. */
#include "asymmetry.h"
#include "controller.h"

/* Place of the first weight of a known term: behind a_i of all plays, b_i of those that have one, and the terms before it. */
int ts_column(const ts_settings *s, ts_term term)
{
    int m = s->plays;
    for (int i = 0; i < s->plays; i++) m += s->rate_dependent[i];
    for (int i = 0; i < (int)term; i++) m += s->terms[i];
    return m;
}

int ts_parameters(const ts_settings *s)
{
    return ts_column(s, TS_TERMS);
}

/* Entries of the prior of the first n weights. */
int ts_prior_entries(const ts_settings *s, int n)
{
    int entries = 0;
    for (int i = 0; i < n; i++) entries += i + 1 - s->prior_from[i];
    return entries;
}

/* Creep states follow the voltage of the tick before, so that they are known before the next one is chosen. */
void ts_remember_creep(ts_memory *memory, const ts_settings *s)
{
    for (int i = 0; i < s->terms[TS_CREEP]; i++) memory->creep[i] += s->creep[i] * (memory->play[0] - memory->creep[i]);
}

/* The output of the amplifier after a tick with the voltage x, V. */
static ts_real behind_amplifier(const ts_memory *memory, const ts_settings *s, ts_real x)
{
    ts_real kept = s->dynamics.amplifier;
    return kept > 0 ? x + kept * (memory->play[0] - x) : x;
}

/* The voltage for a tick after which the output of the amplifier is x, V. */
ts_real ts_before_amplifier(const ts_memory *memory, const ts_settings *s, ts_real x)
{
    ts_real kept = s->dynamics.amplifier;
    return kept > 0 ? x + kept / (1 - kept) * (x - memory->play[0]) : x;
}

void ts_remember_voltage(ts_memory *memory, const ts_settings *s, ts_real x)
{
    x = behind_amplifier(memory, s, x);
    ts_play_bank(x, s->thresholds, memory->play, s->plays);
    memory->ticks++;
}

/* The part of the regressor that is known before the voltage is chosen; u is the place of the first of these terms. */
void ts_known_terms(const ts_settings *s, const ts_memory *memory, const ts_motion *d, ts_real *u)
{
    const int *n = s->terms;
    ts_real asymmetry[TS_MAX_ASYMMETRY];
    ts_asymmetry_terms(within((d->z_d + d->ahead) / s->stroke, -1, 2), asymmetry);
    for (int i = 0; i < n[TS_CREEP]; i++) *u++ = memory->creep[i];
    for (int i = 0; i < n[TS_LAG]; i++) *u++ = d->zdot_d;
    for (int i = 0; i < n[TS_INERTIA]; i++) *u++ = d->zddot_d;
    for (int i = 0; i < n[TS_OFFSET]; i++) *u++ = 1;
    if (n[TS_ASYMMETRY] > 0) *u++ = asymmetry[0];
    if (n[TS_ASYMMETRY] > 1) *u++ = asymmetry[1];
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < n[TS_COUPLING]; i++) *u++ = d->others[i][k];
}

/* (20), and the known terms. */
void ts_regressor(const ts_settings *s, const ts_memory *memory, const ts_motion *d, ts_real *u)
{
    for (int i = 0; i < s->plays; i++) {
        *u++ = memory->play[i];
        if (s->rate_dependent[i]) *u++ = s->rate_scale * d->zdot_d * memory->play[i];
    }
    ts_known_terms(s, memory, d, u);
}
