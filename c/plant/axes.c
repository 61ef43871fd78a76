#include "axes.h"

#include <string.h>

void ts_axes_init(ts_axes *p, const ts_axes_settings *settings, const ts_stage_settings *stages)
{
    memset(p, 0, sizeof *p);
    p->settings = *settings;
    for (int i = 0; i < settings->axes; i++) ts_stage_init(&p->stage[i], &stages[i]);
}

/* What axis i takes of the others as they are now: of their displacement as a force, and behind its modes, um. */
static void take(const ts_axes *p, int i, double steps, double *pushes, double *behind)
{
    const ts_axes_settings *s = &p->settings;
    *pushes = *behind = 0;
    for (int j = 0; j < s->axes; j++) {
        if (j == i) continue;
        double z = p->stage[j].displaced, velocity = (z - p->before[j]) * steps;
        *pushes += s->push[i][j] * z;
        *behind += s->coupling[i][j] * z + s->drag[i][j] * velocity;
    }
}

static void step(ts_axes *p, ts_stage_tick *ticks, int k)
{
    double pushes[TS_AXES_MAX], behind[TS_AXES_MAX], before[TS_AXES_MAX];
    const ts_stage_settings *s = &p->stage[0].settings;
    for (int i = 0; i < p->settings.axes; i++) take(p, i, s->sample_rate * s->steps_per_tick, &pushes[i], &behind[i]);
    for (int i = 0; i < p->settings.axes; i++) {
        ts_stage *stage = &p->stage[i];
        double loaded = ts_stage_load(stage, (k + 1) / (s->sample_rate * s->steps_per_tick));
        before[i] = stage->displaced;
        if (stage->settings.load_on_stage) pushes[i] += loaded;
        else behind[i] += loaded;
        ts_stage_step(stage, &ticks[i], k, pushes[i], behind[i]);
    }
    memcpy(p->before, before, sizeof before);
}

/* As the sensors read it: turned, and with their noise. */
static void read(const ts_axes *p, const double *own, const double *z, const double *noise, double *measured, double *truth)
{
    const int n = p->settings.axes, samples = p->stage[0].settings.samples_per_tick;
    for (int i = 0; i < n; i++) {
        double sum = 0;
        for (int k = 0; k < samples; k++) sum += noise[samples * i + k];
        measured[i] = p->stage[i].settings.noise * (sum / samples);
        truth[i] = 0;
        for (int j = 0; j < n; j++) {
            measured[i] += p->settings.frame[i][j] * own[j];
            truth[i] += p->settings.frame[i][j] * z[j];
        }
    }
}

static void run_tick(ts_axes *p, const double *volts, const double *noise, double *measured, double *truth)
{
    static const double silent[TS_STAGE_MAX_STEPS];
    ts_stage_tick ticks[TS_AXES_MAX];
    double own[TS_AXES_MAX], z[TS_AXES_MAX];
    for (int i = 0; i < p->settings.axes; i++) ts_stage_begin(&p->stage[i], &ticks[i], volts[i], p->pushed[i], silent);
    for (int k = 0; k < p->stage[0].settings.steps_per_tick; k++) step(p, ticks, k);
    for (int i = 0; i < p->settings.axes; i++) {
        p->pushed[i] = ticks[i].pushed;
        ts_stage_end(&p->stage[i], &ticks[i], &own[i], &z[i]);
    }
    read(p, own, z, noise, measured, truth);
}

void ts_axes_run(ts_axes *p, const double *volts, const double *noise, double *measured, double *truth, size_t ticks)
{
    const size_t n = (size_t)p->settings.axes, samples = (size_t)p->stage[0].settings.samples_per_tick;
    for (size_t k = 0; k < ticks; k++) run_tick(p, volts + k * n, noise + k * n * samples, measured + k * n, truth + k * n);
}
