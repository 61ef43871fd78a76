/* A fake libnidaqmx: those functions of the C API that the unmodified Python package `nidaqmx` calls, and one card, Dev1.
 *
 * ao0 .. ao3 each drive an actuator of their own (c/plant/plant.c), ai0 .. ai3 measure it, UM_PER_VOLT um a volt.
 * ai4 is the tip of a microscope over a sample that ao0 moves along x and ao1 along y: SAMPLE(x, y) V, um.
 * At edge i of the sample clock the input converts what the actuator does, then the output goes to its sample i, as on
 * a real card. The clock is that of the output; it stops when a sample is missing (no regeneration).
 *
 *   FAKE_NIDAQMX           file that is the card: struct card, shared by all processes; another name is another card
 *   FAKE_NIDAQMX_REALTIME  the clock runs with the computer's; else it jumps on whenever somebody waits for it
 *   FAKE_NIDAQMX_FAULT     "function:n:what": the n-th call (from 0) of that function fails; n = "*": every call.
 *                          what: an error code, or short (half the samples), nan (a burst of 7), slip (the input
 *                          misses 25 edges), hang (never returns), double (says twice as many channels)
 *   FAKE_NIDAQMX_WATCHDOG  the card has a watchdog for its outputs, and power-up states
 *
 * The watchdog is the card's: when its time is over the terminals have the expiration states, whoever still runs. The
 * file says so by `deadline` (CLOCK_MONOTONIC, s; 0: not armed) and `expiry`; tests/card.py reads it as a voltmeter would.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "plant.h"

#define API __attribute__((visibility("default")))
#define CHANNELS 4
#define INPUTS 5
#define UM_PER_VOLT 10.0
#define SAMPLE(x, y) (sin(2 * M_PI * (x) / 3) * cos(2 * M_PI * (y) / 4) + 0.1 * (x))
#define TASKS 16

enum { NONE = 0, IS_OUTPUT, IS_INPUT, IS_WATCHDOG };

struct card {                 /* the file; tests/card.py reads it */
    double volts[CHANNELS];   /* at the output terminals */
    uint64_t edges;           /* of the sample clock */
    int64_t tasks;            /* that exist, of the last process that asked */
    int64_t owner;            /* process whose task has reserved the output, or 0 */
    int64_t resets;
    double step;              /* the largest that an output has made, V */
    double deadline;          /* of the watchdog, s; 0 if it is not armed */
    double expiry[CHANNELS];  /* V at the terminals from then on */
};

struct task {
    int kind, channels, channel[INPUTS], clocked, reserved, running, error;
    double low, high, rate, timeout;
    size_t size;              /* samples that the buffer holds, each channel */
    uint64_t in, out;         /* samples that have gone into the buffer and out of it */
    double *buffer;           /* [size][INPUTS] */
    int skip;                 /* edges still to miss */
};

static struct card *card;
static char card_path[512];
static ts_plant plants[CHANNELS];
static struct task *tasks[TASKS];
static struct task *output, *input; /* that run on the clock */
static int last_error;
static double started;              /* s */
static struct { const char *name; int calls; } counts[64];

/* ---- Card ----------------------------------------------------------------------------------------------------- */

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void wait_s(double seconds) {
    if (seconds > 0) usleep((useconds_t)(1e6 * seconds) + 1);
}

static int realtime(void) { return getenv("FAKE_NIDAQMX_REALTIME") != NULL; }

static void attach(void) {
    const char *path = getenv("FAKE_NIDAQMX");
    if (!path) path = "/tmp/fake-nidaqmx";
    if (card && strcmp(path, card_path) == 0) return;
    int file = open(path, O_RDWR | O_CREAT, 0600);
    if (file < 0 || ftruncate(file, sizeof *card)) abort();
    card = mmap(NULL, sizeof *card, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (card == MAP_FAILED) abort();
    close(file);
    snprintf(card_path, sizeof card_path, "%s", path);
    const ts_plant_settings settings = PLANT_SETTINGS;
    for (int c = 0; c < CHANNELS; c++) ts_plant_init(&plants[c], &settings);
    memset(counts, 0, sizeof counts);
    output = input = NULL;
}

static double gauss(void) {
    static uint64_t state = 88172645463325252u;
    double sum = -6;
    for (int i = 0; i < 12; i++) {
        state ^= state << 13, state ^= state >> 7, state ^= state << 17;
        sum += (double)(state >> 11) * 0x1p-53;
    }
    return sum;
}

static int expired(void) { return card->deadline > 0 && now() > card->deadline; }

static void put_out(int channel, double volts) {
    if (expired()) return; /* locked */
    card->step = fmax(card->step, fabs(volts - card->volts[channel]));
    card->volts[channel] = volts;
}

/* One edge of the sample clock; 0 when the output has no sample for it. */
static int edge(void) {
    static double measured[INPUTS], truth[CHANNELS];
    if (!output || output->error) return 0;
    if (output->out == output->in) {
        output->error = -200290;
        return 0;
    }
    if (input && !input->error) {
        if (input->skip > 0) input->skip--;
        else {
            for (int i = 0; i < input->channels; i++)
                input->buffer[input->in % input->size * INPUTS + i] = measured[input->channel[i]] / UM_PER_VOLT;
            input->in++;
        }
    }
    for (int i = 0; i < output->channels; i++)
        put_out(output->channel[i], output->buffer[output->out % output->size * INPUTS + i]);
    output->out++;
    card->edges++;
    for (int c = 0; c < CHANNELS; c++) {
        double noise = gauss();
        ts_plant_run(&plants[c], &card->volts[c], &noise, &measured[c], &truth[c], 1);
    }
    measured[CHANNELS] = UM_PER_VOLT * SAMPLE(truth[0], truth[1]);
    return 1;
}

static void catch_up(void) {
    if (output && realtime())
        while ((double)output->out < (now() - started) * output->rate && edge()) {}
}

/* ---- Faults and errors ---------------------------------------------------------------------------------------- */

/* What shall go wrong in this call: "" if nothing. */
static const char *fault(const char *function) {
    static char what[32];
    char name[64], when[16];
    int i = 0;
    while (counts[i].name && strcmp(counts[i].name, function)) i++;
    counts[i].name = function;
    int call = counts[i].calls++;
    const char *text = getenv("FAKE_NIDAQMX_FAULT");
    what[0] = 0;
    if (!text || sscanf(text, "%63[^:]:%15[^:]:%31s", name, when, what) != 3) return "";
    if (strcmp(name, function) || (strcmp(when, "*") && atoi(when) != call)) return "";
    if (strcmp(what, "hang") == 0) for (;;) pause();
    return what;
}

static int failed(int code) { return last_error = code; }

#define BEGIN                                            \
    attach();                                            \
    catch_up();                                          \
    const char *what = fault(__func__);                  \
    if (atoi(what) < 0) return failed(atoi(what));

static const char *text_of(int code) {
    switch (code) {
    case -200290: return "The generation has stopped to prevent the regeneration of old samples.";
    case -200279: return "The application is not able to keep up with the hardware acquisition.";
    case -200284: return "Some or all of the samples requested have not yet been acquired.";
    case -200561: return "Attempted writing analog data that is too large or too small.";
    case -200452: return "Specified property is not supported by the device or is not applicable to the task.";
    case -200678: return "Write failed, because the watchdog timer has expired.";
    case -200220: return "Device identifier is invalid.";
    case -200170: return "Physical channel specified does not exist on this device.";
    case -200324: return "Device is not available for routing. It is possible that the device has been unplugged.";
    case -50103: return "The specified resource is reserved.";
    case -88709: return "Measurement or generation was aborted, as the device was reset.";
    default: return "Something went wrong.";
    }
}

API int32_t DAQmxGetExtendedErrorInfo(char *text, uint32_t size) {
    snprintf(text, size, "%s\n\nStatus Code: %d", text_of(last_error), last_error);
    return 0;
}

API int32_t DAQmxGetErrorString(int32_t code, char *text, uint32_t size) {
    snprintf(text, size, "%s", text_of(code));
    return 0;
}

/* A string the way NI gives it: its size when there is no room. */
static int32_t give(char *to, uint32_t size, const char *text) {
    if (size == 0) return (int32_t)strlen(text) + 1;
    snprintf(to, size, "%s", text);
    return 0;
}

/* ---- Tasks ---------------------------------------------------------------------------------------------------- */

API int32_t DAQmxSetRuntimeEnvironment(const char *a, const char *b, const char *c, const char *d) {
    return a && b && c && d ? 0 : -1;
}

API int32_t DAQmxGetSystemInfoAttribute(int32_t attribute, ...) {
    va_list rest;
    va_start(rest, attribute);
    void *value = va_arg(rest, void *);
    int32_t size = 0;
    if (attribute == 0x193b) size = give(value, va_arg(rest, uint32_t), "Dev1"); /* names of the cards */
    else *(uint32_t *)value = attribute == 0x1272 ? 25 : 0; /* version 25.0.0 */
    va_end(rest);
    return size;
}

API int32_t DAQmxGetDeviceAttribute(const char *device, int32_t attribute, ...) {
    va_list rest;
    va_start(rest, attribute);
    void *value = va_arg(rest, void *);
    int32_t size = 0;
    if (attribute == 0x631) size = give(value, va_arg(rest, uint32_t), "PCIe-6363 (fake)");
    else *(uint32_t *)value = 1; /* its output has a sample clock */
    va_end(rest);
    return strcmp(device, "Dev1") ? failed(-200220) : size;
}

API int32_t DAQmxInternalGetLastCreatedChan(char *name, uint32_t size) { return give(name, size, "channel"); }

API int32_t DAQmxCreateTask(const char *name, struct task **task) {
    (void)name;
    BEGIN
    int i = 0;
    while (tasks[i]) if (++i == TASKS) return failed(-50352);
    *task = tasks[i] = calloc(1, sizeof **task);
    card->tasks++;
    return 0;
}

static void release(struct task *t) {
    if (t->kind == IS_WATCHDOG && !expired()) card->deadline = 0;
    if (t == output) output = NULL;
    if (t == input) input = NULL;
    if (t->reserved && t->kind == IS_OUTPUT && card->owner == getpid()) card->owner = 0;
    t->running = t->reserved = 0;
}

/* Whether a process still runs; one that was killed and not yet waited for does not. */
static int runs(int64_t pid) {
    char path[64], state = 'Z';
    snprintf(path, sizeof path, "/proc/%lld/stat", (long long)pid);
    FILE *file = fopen(path, "r");
    if (!file) return 0;
    if (fscanf(file, "%*d (%*[^)]) %c", &state) != 1) state = 'Z';
    fclose(file);
    return state != 'Z';
}

static int reserve(struct task *t) {
    if (t->reserved || t->kind != IS_OUTPUT) return 0;
    if (card->owner && runs(card->owner)) return failed(-50103);
    card->owner = getpid(); /* the last owner has ended: its tasks went with it */
    t->reserved = 1;
    return 0;
}

API int32_t DAQmxClearTask(struct task *t) {
    attach();
    catch_up();
    release(t);
    for (int i = 0; i < TASKS; i++) if (tasks[i] == t) tasks[i] = NULL;
    free(t->buffer);
    free(t);
    card->tasks--;
    const char *what = fault(__func__);
    return atoi(what) < 0 ? failed(atoi(what)) : 0;
}

API int32_t DAQmxGetTaskAttribute(struct task *t, int32_t attribute, char *value, uint32_t size) {
    (void)t, (void)attribute;
    return give(value, size, "task");
}

/* "Dev1/ao0" or "Dev1/ao0:1". */
static int add_channels(struct task *t, const char *physical, int kind, double low, double high) {
    char device[32], type[8];
    int first, last, n = sscanf(physical, "%31[^/]/%2[a-z]%d:%d", device, type, &first, &last);
    if (n < 1 || strcmp(device, "Dev1")) return failed(-200220);
    if (n == 3) last = first;
    if (n < 3 || strcmp(type, kind == IS_OUTPUT ? "ao" : "ai") || last >= (kind == IS_OUTPUT ? CHANNELS : INPUTS)) return failed(-200170);
    for (int c = first; c <= last; c++) t->channel[t->channels++] = c;
    t->kind = kind, t->low = low, t->high = high;
    return 0;
}

API int32_t DAQmxCreateAOVoltageChan(struct task *t, const char *physical, const char *name, double low, double high,
                                     int32_t units, const char *scale) {
    (void)name, (void)units, (void)scale;
    BEGIN
    return add_channels(t, physical, IS_OUTPUT, low, high);
}

API int32_t DAQmxCreateAIVoltageChan(struct task *t, const char *physical, const char *name, int32_t terminals, double low,
                                     double high, int32_t units, const char *scale) {
    (void)name, (void)units, (void)scale, (void)terminals;
    BEGIN
    return add_channels(t, physical, IS_INPUT, low, high);
}

static void make_buffer(struct task *t, size_t size) {
    free(t->buffer);
    t->size = size;
    t->buffer = calloc(size * INPUTS, sizeof *t->buffer);
}

API int32_t DAQmxCfgSampClkTiming(struct task *t, const char *source, double rate, int32_t edge_, int32_t mode, uint64_t n) {
    (void)edge_, (void)mode;
    BEGIN
    if (t->kind == IS_INPUT && strcmp(source, "/Dev1/ao/SampleClock")) return failed(-200077);
    t->rate = 1e8 / round(1e8 / rate); /* a divider of 100 MHz */
    t->clocked = 1;
    make_buffer(t, t->kind == IS_INPUT && n < 10000 ? 10000 : n);
    return 0;
}

API int32_t DAQmxSetBufferAttribute(struct task *t, int32_t attribute, ...) {
    va_list rest;
    va_start(rest, attribute);
    make_buffer(t, va_arg(rest, uint32_t));
    va_end(rest);
    BEGIN
    return 0;
}

API int32_t DAQmxSetWriteAttribute(struct task *t, int32_t attribute, ...) { /* regeneration: 10158 is "do not allow" */
    (void)t;
    va_list rest;
    va_start(rest, attribute);
    int mode = va_arg(rest, int32_t);
    va_end(rest);
    BEGIN
    return attribute == 0x1453 && mode == 10158 ? 0 : failed(-200077);
}

API int32_t DAQmxGetTimingAttribute(struct task *t, int32_t attribute, ...) {
    (void)attribute;
    va_list rest;
    va_start(rest, attribute);
    *va_arg(rest, double *) = t->rate;
    va_end(rest);
    BEGIN
    return 0;
}

API int32_t DAQmxGetWriteAttribute(struct task *t, int32_t attribute, ...) {
    va_list rest;
    va_start(rest, attribute);
    void *value = va_arg(rest, void *);
    va_end(rest);
    BEGIN
    if (attribute == 0x217e) *(uint32_t *)value = (uint32_t)(t->channels * (strcmp(what, "double") ? 1 : 2));
    else if (attribute == 0x192b) *(uint64_t *)value = t->out;
    else return failed(-200077);
    return 0;
}

API int32_t DAQmxGetReadAttribute(struct task *t, int32_t attribute, ...) {
    va_list rest;
    va_start(rest, attribute);
    void *value = va_arg(rest, void *);
    va_end(rest);
    BEGIN
    if (attribute == 0x217b) *(uint32_t *)value = (uint32_t)(t->channels * (strcmp(what, "double") ? 1 : 2));
    else if (attribute == 0x192a) *(uint64_t *)value = t->in;
    else return failed(-200077);
    return 0;
}

API int32_t DAQmxTaskControl(struct task *t, int32_t action) {
    BEGIN
    return action == 4 ? reserve(t) : 0;
}

API int32_t DAQmxStartTask(struct task *t) {
    BEGIN
    if (t->kind == IS_WATCHDOG) {
        if (!expired()) card->deadline = now() + t->timeout;
        return 0;
    }
    if (reserve(t)) return last_error;
    t->running = 1;
    if (t->kind == IS_INPUT) input = t;
    else output = t, started = now();
    return 0;
}

API int32_t DAQmxStopTask(struct task *t) {
    BEGIN
    int error = t->error;
    release(t);
    return error ? failed(error) : 0;
}

/* ---- The card's own watchdog ------------------------------------------------------------------------------------ */

API int32_t DAQmxCreateWatchdogTimerTaskEx(const char *device, const char *name, struct task **task, double timeout) {
    (void)name;
    BEGIN
    if (strcmp(device, "Dev1")) return failed(-200220);
    if (!getenv("FAKE_NIDAQMX_WATCHDOG")) return failed(-200452);
    int i = 0;
    while (tasks[i]) if (++i == TASKS) return failed(-50352);
    *task = tasks[i] = calloc(1, sizeof **task);
    tasks[i]->kind = IS_WATCHDOG, tasks[i]->timeout = timeout;
    card->tasks++;
    return 0;
}

API int32_t DAQmxCfgWatchdogAOExpirStates(struct task *t, const char *channels, const double *volts, const int32_t *types,
                                          uint32_t n) {
    BEGIN
    uint32_t i = 0;
    for (const char *at = channels; i < n; i++, at = strchr(at, ',') + 1) {
        while (*at == ' ') at++;
        if (t->kind != IS_WATCHDOG || types[i] != 10322 || sscanf(at, "Dev1/ao%d", &t->channel[i]) != 1) return failed(-200170);
        card->expiry[t->channel[i]] = volts[i];
        if (!strchr(at, ',')) break;
    }
    return i + 1 >= n ? 0 : failed(-200170);
}

API int32_t DAQmxControlWatchdogTask(struct task *t, int32_t action) {
    BEGIN
    if (action == 0 && expired()) return failed(-200678);
    card->deadline = now() + t->timeout;
    return 0;
}

API int32_t DAQmxGetWatchdogAttribute(struct task *t, const char *lines, int32_t attribute, ...) {
    (void)t, (void)lines;
    va_list rest;
    va_start(rest, attribute);
    *va_arg(rest, uint32_t *) = (uint32_t)expired();
    va_end(rest);
    return attribute == 0x21a8 ? 0 : failed(-200452);
}

API int32_t DAQmxGetAnalogPowerUpStatesWithOutputType(const char *channels, double *volts, int32_t *types, uint32_t *n) {
    BEGIN
    (void)channels;
    if (!getenv("FAKE_NIDAQMX_WATCHDOG")) return failed(-200452);
    for (uint32_t i = 0; i < *n; i++) volts[i] = 0, types[i] = 0;
    return 0;
}

API int32_t DAQmxResetDevice(const char *device) {
    BEGIN
    if (strcmp(device, "Dev1")) return failed(-200220);
    for (int i = 0; i < TASKS; i++) if (tasks[i]) tasks[i]->error = -88709;
    for (int c = 0; c < CHANNELS; c++) put_out(c, 0);
    card->owner = 0;
    card->deadline = 0;
    card->resets++;
    return 0;
}

/* ---- Samples; fill mode 0, by channel --------------------------------------------------------------------------- */

API int32_t DAQmxWriteAnalogF64(struct task *t, int32_t n, uint32_t start, double timeout, int32_t mode, const double *data,
                                int32_t *written, void *reserved) {
    (void)mode, (void)reserved, (void)start;
    *written = 0;
    BEGIN
    if (t->error) return failed(t->error);
    for (int i = 0; i < n * t->channels; i++)
        if (!(data[i] >= t->low && data[i] <= t->high)) return failed(-200561);
    if (reserve(t)) return last_error;
    if (!t->clocked && expired()) return failed(-200678);
    if (!t->clocked) { /* on demand */
        for (int i = 0; i < t->channels; i++) put_out(t->channel[i], data[i * n]);
        *written = n;
        return 0;
    }
    if (strcmp(what, "short") == 0) n /= 2;
    for (int k = 0; k < n; k++) {
        double end = now() + timeout;
        while (t->in - t->out >= t->size) { /* no room */
            if (!t->running || now() > end) return failed(-200292);
            if (realtime()) wait_s(1e-4), catch_up();
            else edge();
        }
        for (int i = 0; i < t->channels; i++) t->buffer[t->in % t->size * INPUTS + i] = data[i * n + k];
        t->in++;
    }
    *written = n;
    return 0;
}

API int32_t DAQmxReadAnalogF64(struct task *t, int32_t n, double timeout, int32_t mode, double *data, uint32_t size,
                               int32_t *read, void *reserved) {
    (void)mode, (void)reserved, (void)size;
    *read = 0;
    BEGIN
    if (t->error) return failed(t->error);
    if (strcmp(what, "slip") == 0) t->skip = 25;
    double end = now() + timeout;
    while (t->in < t->out + (uint64_t)n) {
        if (realtime() ? now() > end : !edge()) return failed(-200284);
        if (realtime()) wait_s(1e-4), catch_up();
    }
    if (t->in - t->out > t->size) return failed(t->error = -200279);
    if (strcmp(what, "short") == 0) n /= 2;
    for (int k = 0; k < n; k++, t->out++)
        for (int i = 0; i < t->channels; i++) data[i * n + k] = t->buffer[t->out % t->size * INPUTS + i];
    if (strcmp(what, "nan") == 0)
        for (int k = 0; k < 7; k++) data[10 + k] = NAN; /* the third tick, and a part of the fourth */
    *read = n;
    return 0;
}
