/* The terms of the model: the plays with their rates, and those that are known before the voltage is chosen. */
#include "asymmetry.h"
#include "controller.h"

#define AT_ITS_END ((ts_real)0.999) /* of its threshold: a play that is so far from the voltage moves with it */
#define FAR 100 /* lengths of a state of Duhem that the voltage moves in a tick, at most: it has forgotten all long before */

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

/* By how much a state of Duhem changes when the voltage moves, V. It follows the voltage as far as that moves, not as time goes, so that it
 * does not depend on the sample rate: by 1 - exp(-|moved| / length) of its distance from the middle of the move, to the second order. */
static ts_real duhem_change(const ts_settings *s, const ts_memory *memory, ts_real moved, int i)
{
    ts_real way = within(size_of(moved) / s->duhem[i], 0, FAR), grown = way + way * way / 2;
    return grown / (1 + grown) * (memory->play[0] + moved / 2 - memory->duhem[i]);
}

/* By how much the states of Duhem change the displacement per volt, um/V; `up` where the voltage begins to move, and rises. */
ts_real ts_slope_of_duhem(const ts_settings *s, const ts_memory *memory, const ts_real *w, ts_real moved, bool up)
{
    ts_real sum = 0;
    w += ts_column(s, TS_DUHEM);
    for (int i = 0; i < s->terms[TS_DUHEM]; i++) {
        ts_real begins = (memory->play[0] - memory->duhem[i]) / (up ? s->duhem[i] : -s->duhem[i]);
        sum += w[i] * (size_of(moved) > 0 ? duhem_change(s, memory, moved, i) / moved : begins);
    }
    return sum;
}

/* The output of the amplifier, whose lag keeps this share of a tick before, after a tick with the voltage x, V. */
static ts_real behind_amplifier(const ts_memory *memory, ts_real kept, ts_real x)
{
    return kept > 0 ? x + kept * (memory->play[0] - x) : x;
}

/* The voltage for a tick after which the output of the amplifier is x, V. */
ts_real ts_before_amplifier(const ts_memory *memory, ts_real kept, ts_real x)
{
    return kept > 0 ? x + kept / (1 - kept) * (x - memory->play[0]) : x;
}

void ts_remember_voltage(ts_memory *memory, const ts_settings *s, ts_real kept, ts_real x)
{
    x = behind_amplifier(memory, kept, x);
    for (int i = 0; i < s->terms[TS_DUHEM]; i++) memory->duhem[i] += duhem_change(s, memory, x - memory->play[0], i);
    ts_play_bank(x, s->thresholds, memory->play, s->plays);
    memory->ticks++;
}

/* The plays as if the voltage had been this one, V, where it had to come to: those that move go with it, the others stay where they
 * can. */
void ts_move_voltage(ts_memory *memory, const ts_settings *s, ts_real to)
{
    ts_real from = memory->play[0];
    for (int i = 0; i < s->plays; i++) {
        ts_real r = s->thresholds[i], moves = size_of(memory->play[i] - from) < AT_ITS_END * r ? 0 : to - from;
        memory->play[i] = within(memory->play[i] + moves, to - r, to + r);
    }
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
    for (int i = 0; i < n[TS_DUHEM]; i++) *u++ = memory->duhem[i];
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
