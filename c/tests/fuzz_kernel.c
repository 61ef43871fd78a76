/* Fuzzer of the kernel: bytes become settings and a sequence of calls with any arguments; see `invariants` for what must hold.
 *
 * With clang it is a libFuzzer target; without it `main` below generates the bytes itself, from a seed. Both take files as
 * arguments, to repeat what was found. */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "invariants.h"
#include "truestroke.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static struct {
    unsigned long long inputs, refused, stages, late, commands, measured, changes, starts, repetitions, joined;
} seen;

static void report(void)
{
    printf("fuzz (%s): %llu inputs, %llu with refused settings, %llu with a stage, %llu with a late sensor; %llu commands, %llu measurements used, %llu changes, "
           "%llu starts, %llu repetitions, %llu calls with what was learned\n", sizeof(ts_real) == 8 ? "double" : "float", seen.inputs, seen.refused, seen.stages, seen.late, seen.commands,
           seen.measured, seen.changes, seen.starts, seen.repetitions, seen.joined);
}

/* ---- Bytes ----------------------------------------------------------------------------------------------------------- */

typedef struct {
    const uint8_t *data;
    size_t left;
} bytes;

static unsigned byte(bytes *b)
{
    if (b->left == 0) return 0;
    b->left--;
    return *b->data++;
}

static int below(bytes *b, int n) { return (int)((byte(b) << 8 | byte(b)) % (unsigned)n); }

static double between(bytes *b, double low, double high)
{
    return low + (high - low) * below(b, 65536) / 65535.0;
}

/* Any number: mostly one of about `size`, else an extreme one, or eight raw bytes. */
static ts_real any(bytes *b, double size)
{
    static const double extremes[] = {0, -0.0, 1, -1, 1e308, -1e308, DBL_MAX, DBL_MIN, 5e-324, -5e-324, 1e-300, 1e30, -1e30,
                                      1e12, -1e12, 1e15, 1e60, -1e60, 1e150, 3e38, 1e-38, 1e-12, NAN, INFINITY, -INFINITY};
    unsigned kind = byte(b);
    if (kind < 160) return (ts_real)between(b, -size, size);
    if (kind < 220) return (ts_real)extremes[kind % (sizeof extremes / sizeof *extremes)];
    uint8_t raw[8];
    for (int i = 0; i < 8; i++) raw[i] = (uint8_t)byte(b);
    double value;
    memcpy(&value, raw, sizeof value);
    return (ts_real)value;
}

/* ---- Settings -------------------------------------------------------------------------------------------------------- */

/* Of 180 and 500 Hz at 2 kHz with a lag of 400 Hz and a dead time, with its feedback: as the package computes them. */
static void on_stage(ts_settings *s)
{
    s->dynamics = (ts_dynamics){
        .known = true, .first = (ts_real)0.09, .sections = 3, .dead = 1, .modes = 1, .others = 2,
        .section = {{(ts_real)-0.2347904, (ts_real)0.4033557, (ts_real)-1.6697850, (ts_real)0.9776344},
                    {(ts_real)-0.0771749, (ts_real)0.0252292, (ts_real)-0.0013489, (ts_real)0.9100572},
                    {(ts_real)0.3986473, 0, (ts_real)-0.2846095, 0}},
        .direct = {(ts_real)-0.0775397, (ts_real)-4.7e-5, 0},
        .notch = {(ts_real)3.2483416, (ts_real)-5.4240321, (ts_real)3.1756906},
        .mode = {{(ts_real)0.6807805, (ts_real)-0.0009183, (ts_real)0.6195492, (ts_real)-0.0902497, (ts_real)0.3896611}},
        .quiet = {(ts_real)0.3249084, (ts_real)-0.5425272, (ts_real)0.3176416},
        .tap = {(ts_real)-15.4588592, (ts_real)-4.2703823, (ts_real)-0.3911656, (ts_real)-2.381e-4, 0},
        .rest = {{(ts_real)1.3433356, (ts_real)0.4253824, (ts_real)-0.0902497, (ts_real)0.3896611},
                 {(ts_real)14.1357409, 0, (ts_real)-0.2846095, 0}},
        .lead = {(ts_real)1.0316e-3, (ts_real)1.1453e-6}};
    s->feedback = (ts_feedback){.filters = 3, .most = 3,
        .filter = {{(ts_real)0.4556781, 0, 0, (ts_real)-0.9992413, 0}, {(ts_real)-0.3792037, 0, 0, (ts_real)-0.9977256, 0},
                   {(ts_real)0.0746837, (ts_real)-0.3825277, (ts_real)0.1583564, (ts_real)-0.3956661, (ts_real)0.1381793}}};
}

static ts_settings sane(bytes *b)
{
    ts_settings s = {.plays = 1 + below(b, TS_MAX_PLAYS), .dead_zones = 1, .dead_zone_weights = {1},
                     .rate_scale = (ts_real)7e-4, .stroke = 30, .forgetting = (ts_real)0.999, .regularization = (ts_real)1e-3,
                     .covariance_limit = (ts_real)1e6, .slope_min = 3, .slope_max = 28, .velocity_limit = 1500,
                     .voltage_min = (ts_real)-0.6, .voltage_max = (ts_real)3.6, .slew = (ts_real)0.25,
                     .measurement_limit = 300, .smoothing = (ts_real)0.5, .first_noise = (ts_real)0.03};
    for (int i = 0; i < s.plays; i++) {
        s.thresholds[i] = (ts_real)(1.5 * i / s.plays);
        s.rate_dependent[i] = i % 3 == 0;
    }
    s.law = below(b, 4) ? TS_LAW_KALMAN : TS_LAW_RLS;
    unsigned terms = byte(b);
    s.terms[TS_LAG] = terms & 1, s.terms[TS_OFFSET] = terms >> 1 & 1;
    s.terms[TS_ASYMMETRY] = (int)(terms >> 2) % 3, s.terms[TS_CREEP] = (int)(terms >> 4) % 5;
    s.terms[TS_COUPLING] = s.terms[TS_COUPLING_LAG] = s.terms[TS_COUPLING_INERTIA] = terms >> 7 ? 1 + below(b, TS_MAX_OTHERS) : 0;
    for (int i = 0; i < s.terms[TS_CREEP]; i++) s.creep[i] = (ts_real)(0.15 / (1 << 2 * i));
    s.initial_weights[0] = 8;
    s.kalman = (ts_kalman_settings){
        .filter = (ts_real)0.6, .noise_rate = (ts_real)1e-3, .ringing_rate = (ts_real)0.1,
        .model_error = (ts_real)6e-3, .prior_return = (ts_real)8e-8, .change_threshold = 12,
        .change_rate = (ts_real)0.2, .refractory = 10, .change_gain = (ts_real)0.15,
        .change_hysteresis = (ts_real)0.3, .change_share = (ts_real)2e-3, .outlier = 12, .outliers = 3};
    unsigned stage = byte(b);
    s.terms[TS_DUHEM] = (int)(stage >> 6);
    for (int i = 0; i < s.terms[TS_DUHEM]; i++) s.duhem[i] = (ts_real)(4.2 / (1 << 2 * i));
    for (int i = 0; i < ts_parameters(&s); i++) s.prior[TS_PACKED(i) + i] = i ? (ts_real)0.5 : 9;
    if (stage & 3) /* three of four watch it, some are given its resonance */
        s.oscillation = (ts_oscillation_settings){
            .tick = (ts_real)5e-4, .corner = (ts_real)0.17, .fast = (ts_real)0.6, .slow = (ts_real)0.05,
            .motion_rate = (ts_real)5e-3, .noise_share = 2, .floor = (ts_real)0.15, .large = (ts_real)0.6};
    if (stage & 4) s.guard = (ts_guard_settings){.window = 6, .range_rate = (ts_real)5e-3, .floor = (ts_real)0.06, .burst = 5, .recall = 3};
    if (stage & 8 && s.law == TS_LAW_KALMAN) on_stage(&s);
    else if (stage & 16) /* a sensor that is late by 2.3 ticks, behind a lag of one tick */
        s.sensor = (ts_sensor){.ticks = 2, .share = (ts_real)0.3, .lag = 1, .pole = (ts_real)0.3678794,
                               .now = (ts_real)0.3678794, .before = (ts_real)0.2642411, .slow = {(ts_real)-5e-4, (ts_real)2.5e-7}};
    if ((stage & 3) == 3) s.resonance = (ts_real)(stage >> 2) / 128;
    return s;
}

/* One entry becomes any number. */
static void disturb(bytes *b, ts_settings *s)
{
    ts_kalman_settings *k = &s->kalman;
    ts_oscillation_settings *o = &s->oscillation;
    ts_real *const entries[] = {
        &o->tick, &o->corner, &o->fast, &o->slow, &o->motion_rate, &o->noise_share, &o->floor, &o->large, &s->resonance,
        &s->guard.range_rate, &s->guard.floor, &s->guard.burst,
        &s->rate_scale, &s->stroke, &s->forgetting, &s->regularization, &s->covariance_limit, &s->slope_min, &s->slope_max,
        &s->velocity_limit, &s->voltage_min, &s->voltage_max, &s->slew, &s->measurement_limit, &s->smoothing, &s->trim,
        &s->first_noise, &k->filter, &k->noise_rate, &k->ringing_rate, &k->model_error, &k->prior_return,
        &k->change_threshold, &k->change_rate, &k->change_gain, &k->change_hysteresis, &k->change_share, &k->outlier,
        &s->thresholds[below(b, TS_MAX_PLAYS)], &s->creep[below(b, TS_MAX_CREEPS)], &s->duhem[below(b, TS_MAX_DUHEM)],
        &s->initial_weights[below(b, TS_MAX_PARAMETERS)], &s->prior[below(b, TS_PACKED(TS_MAX_PARAMETERS))],
        &s->dead_zone_weights[below(b, TS_MAX_DEAD_ZONES)], &s->dead_zone_thresholds[below(b, TS_MAX_DEAD_ZONES)]};
    enum { ENTRIES = sizeof entries / sizeof *entries };
    int which = below(b, ENTRIES + 9);
    if (which < ENTRIES) {
        ts_real *entry = entries[which], value = any(b, below(b, 2) ? 1 : 100);
        *entry = value;
        return;
    }
    int number = below(b, 65536) - 32768;
    int *const counts[] = {&s->plays, &s->dead_zones, &s->terms[TS_CREEP], &s->terms[TS_ASYMMETRY], &s->terms[TS_DUHEM], &k->refractory, &k->outliers};
    if (which - ENTRIES < 7) *counts[which - ENTRIES] = number % 40;
    else s->rate_dependent[below(b, TS_MAX_PLAYS)] ^= 1;
}

/* ---- What must hold --------------------------------------------------------------------------------------------------- */

static void (*at_failure)(void);

static void require(bool holds, const char *what)
{
    if (holds) return;
    fprintf(stderr, "the kernel violated: %s\n", what);
    if (at_failure) at_failure();
    abort();
}

typedef struct {
    ts_controller c;
    ts_settings settings[2]; /* the present ones, and a place for the next */
    bool tame;         /* only settings and desired values that are realistic: P must stay positive definite */
    ts_real plant[2];  /* of a plausible actuator, V */
} bench;

static void invariants(const bench *t)
{
    const ts_controller *c = &t->c;
    require(finite_state(c), "the state is finite");
    require(c->lagged.ticks <= c->counters.commands && c->counters.commands - c->lagged.ticks <= TS_HISTORY,
            "no more commands wait than there is room for");
    require(c->beyond >= 0 && c->beyond <= TS_BEYOND, "ticks beyond are counted up to TS_BEYOND");
    ts_real least = c->settings->law == TS_LAW_KALMAN ? TS_IN_MOTION * c->settings->slope_min : c->settings->slope_min;
    for (int i = 0; i < c->settings->plays; i++)
        require(c->slopes[i] >= least && c->slopes[i] <= c->settings->slope_max, "slopes are within limits");
    if (c->settings->law == TS_LAW_KALMAN) require(symmetric(c->law.kalman.P, c->parameters), "P is symmetric");
    else for (int i = 0; i < c->parameters; i++) require(c->law.rls.D[i] >= 0, "D is not negative");
}

/* ---- Calls ------------------------------------------------------------------------------------------------------------ */

static ts_real command(bench *t, ts_real z_d, ts_real zdot_d)
{
    static ts_controller before;
    ts_controller *c = &t->c;
    const ts_settings *s = c->settings;
    ts_real last = c->now.play[0], volts = last;
    bool number = isfinite(z_d) && isfinite(zdot_d);
    if (!number) before = *c;
    ts_real others[3 * TS_MAX_OTHERS];
    for (int i = 0; i < 3 * TS_MAX_OTHERS; i++) others[i] = i % 2 ? zdot_d : z_d;
    ts_status status = s->terms[TS_COUPLING] ? ts_controller_follow(c, z_d, zdot_d, (ts_real)NAN, (ts_real)NAN, others, &volts)
                                             : ts_controller_command(c, z_d, zdot_d, &volts);
    require((status == TS_OK) == number, "a command is refused where it is not finite");
    if (!number) require(memcmp(&before, c, sizeof before) == 0, "a refused command changes nothing");
    else seen.commands++;
    if (!number) return volts;
    require(volts >= s->voltage_min && volts <= s->voltage_max, "the voltage is within its limits");
    bool inside = last >= s->voltage_min && last <= s->voltage_max; /* not at the first tick, not at new limits */
    require(!inside || fabs((double)volts - (double)last) <= (double)s->slew + 1e-6 * (double)(s->voltage_max - s->voltage_min),
            "the voltage keeps to slew");
    return volts;
}

static uint64_t measured(const ts_controller *c) { return c->settings->dynamics.known ? c->dynamics.ticks : c->lagged.ticks; }

static void adapt(bench *t, ts_real z, int ago)
{
    ts_controller *c = &t->c;
    uint64_t commands = c->counters.commands, waiting = commands - measured(c);
    bool early = ago >= 0 && (uint64_t)ago < commands && (uint64_t)(ago + c->settings->sensor.ticks) >= commands;
    ts_status status = ts_controller_adapt(c, z, ago);
    seen.measured += status == TS_OK;
    require(status == TS_OK || status == TS_REJECTED || (status == TS_BEYOND_REACH && measured(c) == 0),
            "a measurement is used, rejected, or the first one and beyond reach");
    require(status != TS_OK || early || (ago >= 0 && (uint64_t)ago < waiting && fabs((double)z) <= (double)c->settings->measurement_limit),
            "a measurement that is used is within limits and in time");
}

/* Ticks of a motion that somebody might ask for, with an actuator that might be there. */
static void ticks(bench *t, bytes *b)
{
    int count = 1 + (int)byte(b), sensor = below(b, 12);
    double z = between(b, -10, 40), rate = between(b, -300, 300), noise = between(b, 0, 0.1);
    for (int k = 0; k < count; k++) {
        z += rate * 5e-4;
        if (z < -5 || z > 35) rate = -rate;
        ts_real volts = command(t, (ts_real)z, (ts_real)rate);
        ts_play_bank(volts, (ts_real[]){0, (ts_real)0.45}, t->plant, 2);
        double truth = 9 * (double)t->plant[0] + 4 * (double)t->plant[1] + noise * ((k * 7919 % 211) / 105.0 - 1);
        ts_real shown = sensor == 0 ? (ts_real)NAN : (ts_real)(sensor == 1 ? -truth : sensor == 2 ? 12 : truth);
        if (sensor != 3) adapt(t, shown, sensor == 4);
    }
}

static void start(bench *t, bytes *b)
{
    static ts_controller before;
    ts_real volts = any(b, 4), z = any(b, 120);
    before = t->c;
    ts_status status = ts_controller_start(&t->c, volts, z);
    seen.starts += status == TS_OK;
    if (status != TS_OK) {
        require(memcmp(&before, &t->c, sizeof before) == 0, "a refused start changes nothing");
        return;
    }
    t->plant[0] = t->plant[1] = volts;
    require(isfinite(volts) && fabs((double)z) <= (double)ts_reach(t->c.settings, volts), "a start is within reach");
}

static void change(bench *t, bytes *b)
{
    static ts_controller before;
    ts_settings next = *t->c.settings, *free = &t->settings[t->c.settings == t->settings];
    for (int n = 1 + below(b, 3); n > 0; n--) disturb(b, &next);
    before = t->c;
    *free = next;
    bool taken = ts_controller_change(&t->c, free) == TS_OK;
    if (!taken) require(memcmp(&before, &t->c, sizeof before) == 0, "a refused change changes nothing");
    else t->tame = false;
    seen.changes += taken;
}

static void call(bench *t, bytes *b)
{
    ts_controller *c = &t->c;
    unsigned what = byte(b);
    if (what < 90) ticks(t, b);
    else if (what < 140) {
        ts_real z_d = any(b, 60), zdot_d = any(b, 2000);
        t->tame &= fabs((double)z_d) < 1e4 && fabs((double)zdot_d) < 1e5;
        command(t, z_d, zdot_d);
    } else if (what < 190) {
        ts_real z = any(b, 300);
        adapt(t, z, byte(b) < 200 ? 0 : below(b, 80) - 8);
    } else if (what < 205) ts_controller_hold(c, what % 2);
    else if (what < 215) ts_controller_reset(c);
    else if (what < 235) start(t, b);
    else change(t, b);
}

/* ---- Repetition ------------------------------------------------------------------------------------------------------- */

enum { MOST = 64 };

/* Any settings, waves and calls; desired values of a motion that may repeat, and any. */
static void repetition(bytes *b)
{
    static ts_real memory[2 * MOST], wave[MOST], table[2][MOST];
    int size = 16 + below(b, MOST - 15), form = below(b, 3);
    double turn = 6.283185307179586 / size;
    for (int k = 0; k < size; k++) {
        wave[k] = (ts_real)(form == 0 ? cos(turn * k) : form == 1 ? abs(2 * k - size) / (double)size : between(b, -1, 1));
        for (int i = 0; i < 2; i++) table[i][k] = (ts_real)between(b, -1, 1);
    }
    ts_shape shape = {wave, 0, any(b, 3), any(b, 30), any(b, 3), any(b, 30), any(b, 30)};
    if (form == 0) shape = (ts_shape){wave, 0, 2, (ts_real)(0.5 * size), (ts_real)(0.5 * size * turn * turn), (ts_real)(0.5 * size), 0};
    ts_learned_period learned = {shape, table[0], (ts_real)between(b, -1, 1), any(b, 10)};
    ts_repetition_settings s = {size, (ts_real)(size + between(b, -1, 1)), (ts_real)between(b, 0.9, 50), (ts_real)between(b, -0.1, 1), (ts_real)cos(turn), (ts_real)sin(turn), (ts_real)between(b, 0.9, 10), below(b, 100), NULL};
    if (below(b, 2)) s.learned = &learned;
    ts_repetition r;
    if (!ts_repetition_init(&r, &s, memory)) return;
    double phase = 0, pace = between(b, 0.98, 1.02), amplitude = between(b, 0, 3), offset = between(b, -5, 5);
    while (b->left > 0) {
        unsigned what = byte(b);
        ts_real low = (ts_real)-2, high = 2, slew = (ts_real)0.5, last = r.last;
        bool corrects = r.corrects;
        if (what < 8) amplitude = between(b, 0, 3);
        else if (what < 12) ts_repetition_trigger(&r);
        else if (what < 16) ts_repetition_leave(&r);
        else if (what < 24 && !s.learned) ts_repetition_become(&r, what < 20 ? table[what % 2] : NULL, (ts_real)between(b, -1, 1), below(b, 60));
        else if (what < 28 && !s.learned) ts_repetition_move(&r, (ts_real)between(b, -2, 2), 1 + (ts_real)below(b, 50));
        else if (what < 40) ts_repetition_tick(&r, any(b, 10));
        ts_real error = any(b, 3), gain = any(b, 10);
        for (int k = 0; k < (what > 60 ? 7 * size : 1); k++) {
            phase += pace;
            double x = form == 0 ? cos(turn * phase) : (double)wave[(int)phase % size];
            ts_repetition_tick(&r, (ts_real)(offset + amplitude * x));
            ts_real volts = ts_repetition_volts(&r, (ts_real)(2 * cos(0.7 * k)), low, high, slew);
            require(volts >= low && volts <= high, "the voltage is within its limits");
            if (corrects && r.corrects) require(fabs((double)(volts - last)) <= 0.5 + 1e-5, "the voltage keeps to slew");
            last = volts;
            corrects = r.corrects;
            ts_repetition_see(&r, error, gain);
            require(sound(&r), "the state of a repetition is sound");
            require(r.goal >= -4 && r.goal <= 4, "the level is within the range");
        }
        seen.joined += r.joined;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static bench t;
    bytes b = {data, size};
    if (byte(&b) % 8 == 7) {
        seen.repetitions++;
        repetition(&b);
        return 0;
    }
    ts_settings s = sane(&b);
    int disturbed = below(&b, 5);
    memset(&t, 0, sizeof t);
    t.tame = disturbed == 0;
    for (int n = disturbed; n > 0; n--) disturb(&b, &s);
    if (seen.inputs++ == 0) atexit(report);
    t.settings[0] = s;
    if (ts_controller_init(&t.c, &t.settings[0]) != TS_OK) {
        seen.refused++;
        return 0;
    }
    seen.stages += s.dynamics.known;
    seen.late += s.sensor.ticks > 0;
    invariants(&t);
    while (b.left > 0) {
        call(&t, &b);
        invariants(&t);
    }
    ts_controller_complete(&t.c);
    invariants(&t);
    if (t.tame && s.law == TS_LAW_KALMAN && sizeof(ts_real) == 8)
        require(definite(t.c.law.kalman.P, t.c.parameters), "P is positive definite");
    return 0;
}

/* ---- Alone ------------------------------------------------------------------------------------------------------------ */

#ifdef TS_STANDALONE
#include <time.h>

void __sanitizer_set_death_callback(void (*callback)(void));

enum { LONGEST = 2048 };
static uint8_t input[LONGEST];
static size_t length;

static void keep(void)
{
    FILE *file = fopen("fuzz-found.bin", "wb");
    if (!file) return;
    fwrite(input, 1, length, file);
    fclose(file);
    fprintf(stderr, "the input is in fuzz-found.bin: give it as an argument to repeat it\n");
}

static uint64_t random_bits(uint64_t *state) /* splitmix64 */
{
    uint64_t x = *state += 0x9e3779b97f4a7c15u;
    x = (x ^ x >> 30) * 0xbf58476d1ce4e5b9u;
    x = (x ^ x >> 27) * 0x94d049bb133111ebu;
    return x ^ x >> 31;
}

static int repeat(const char *name)
{
    FILE *file = fopen(name, "rb");
    if (!file) return perror(name), 1;
    length = fread(input, 1, LONGEST, file);
    fclose(file);
    return LLVMFuzzerTestOneInput(input, length);
}

/* Arguments: seconds and seed; or files to repeat. */
int main(int count, char **arguments)
{
    char *end = NULL;
    double seconds = count > 1 ? strtod(arguments[1], &end) : 60;
    if (count > 1 && *end) {
        int failed = 0;
        for (int i = 1; i < count; i++) failed |= repeat(arguments[i]);
        return failed;
    }
    uint64_t state = count > 2 ? strtoull(arguments[2], NULL, 10) : 1;
    printf("fuzz: %g s from seed %llu\n", seconds, (unsigned long long)state);
    time_t begin = time(NULL);
    __sanitizer_set_death_callback(keep);
    at_failure = keep;
    while (difftime(time(NULL), begin) < seconds) {
        length = 16 + random_bits(&state) % (LONGEST - 16);
        for (size_t i = 0; i < length; i++) input[i] = (uint8_t)random_bits(&state);
        LLVMFuzzerTestOneInput(input, length);
    }
    return 0;
}
#endif
