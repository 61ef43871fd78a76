/* FMI 2.0 for co-simulation around a unit (unit.h). */
#include "fmi2.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "unit.h"

typedef enum { INSTANTIATED, INITIALISING, STEPPING, TERMINATED } phase;

typedef struct {
    fmu_state state;
    phase phase;
    double begin; /* s: time of the first tick */
    fmi2CallbackFunctions calls;
    char name[64];
} instance;

/* Says what is wrong. The text is complete: many importers do not fill in what a format asks for. */
#define LOG(m, ...) \
    do { \
        char text[256]; \
        snprintf(text, sizeof text, __VA_ARGS__); \
        if ((m)->calls.logger) (m)->calls.logger((m)->calls.componentEnvironment, (m)->name, fmi2Error, "logStatusError", text); \
    } while (0)

static fmi2Status out_of_bounds(instance *m, const fmu_variable *v, double value)
{
    LOG(m, "%s = %.17g%s%s: must be from %.6g to %.6g", v->name, value, *v->unit ? " " : "", v->unit, v->low, v->high);
    return fmi2Error;
}

static void at_start(instance *m)
{
    memset(&m->state, 0, sizeof m->state);
    for (int i = 0; i < FMU_VARIABLES; i++) m->state.value[i] = fmu_variables[i].start;
    m->phase = INSTANTIATED;
    m->begin = 0;
}

/* ---- Life -------------------------------------------------------------------------------------------------------- */

fmi2String FMI2(fmi2GetTypesPlatform)(void) { return "default"; }
fmi2String FMI2(fmi2GetVersion)(void) { return "2.0"; }

fmi2Component FMI2(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                    const fmi2CallbackFunctions *calls, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources, (void)visible, (void)logging;
    if (!calls || !calls->allocateMemory || !calls->freeMemory || type != fmi2CoSimulation) return NULL;
    instance *m = calls->allocateMemory(1, sizeof *m);
    if (!m) return NULL;
    m->calls = *calls;
    snprintf(m->name, sizeof m->name, "%s", name ? name : "");
    if (!guid || strcmp(guid, fmu_guid) != 0) {
        LOG(m, "guid %s: this FMU has %s", guid ? guid : "", fmu_guid);
        calls->freeMemory(m);
        return NULL;
    }
    at_start(m);
    return m;
}

void FMI2(fmi2FreeInstance)(fmi2Component c)
{
    instance *m = c;
    if (m) m->calls.freeMemory(m);
}

fmi2Status FMI2(fmi2SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t count, const fmi2String categories[])
{
    (void)c, (void)on, (void)count, (void)categories;
    return fmi2OK;
}

fmi2Status FMI2(fmi2SetupExperiment)(fmi2Component c, fmi2Boolean given, fmi2Real tolerance, fmi2Real start, fmi2Boolean ends,
                                     fmi2Real stop)
{
    (void)given, (void)tolerance, (void)ends, (void)stop;
    ((instance *)c)->begin = start;
    return fmi2OK;
}

fmi2Status FMI2(fmi2EnterInitializationMode)(fmi2Component c)
{
    ((instance *)c)->phase = INITIALISING;
    return fmi2OK;
}

fmi2Status FMI2(fmi2ExitInitializationMode)(fmi2Component c)
{
    instance *m = c;
    for (int i = 0; i < FMU_VARIABLES; i++) {
        const fmu_variable *v = &fmu_variables[i];
        double value = m->state.value[i];
        if (v->role == FMU_PARAMETER && !(value >= v->low && value <= v->high)) return out_of_bounds(m, v, value);
    }
    const char *wrong = fmu_begin(&m->state);
    if (wrong) {
        LOG(m, "%s: out of range, or not in order", wrong);
        return fmi2Error;
    }
    m->phase = STEPPING;
    return fmi2OK;
}

fmi2Status FMI2(fmi2Terminate)(fmi2Component c)
{
    ((instance *)c)->phase = TERMINATED;
    return fmi2OK;
}

fmi2Status FMI2(fmi2Reset)(fmi2Component c)
{
    at_start(c);
    return fmi2OK;
}

/* ---- Values ------------------------------------------------------------------------------------------------------ */

/* The place of a variable of this type, to be read or set; NULL, and a line in the log, where it may not be. */
static double *place(instance *m, fmi2ValueReference which, fmu_type type, int set)
{
    if (which >= FMU_VARIABLES || fmu_variables[which].type != type) {
        LOG(m, "there is no variable %u of this type", which);
        return NULL;
    }
    const fmu_variable *v = &fmu_variables[which];
    if (set && (v->role == FMU_OUTPUT || (v->role == FMU_PARAMETER && m->phase >= STEPPING))) {
        LOG(m, "%s is %s", v->name, v->role == FMU_OUTPUT ? "an output: it cannot be set" : "set before the first step only");
        return NULL;
    }
    return &m->state.value[which];
}

#define ACCESS(name, kind, type) \
    fmi2Status FMI2(fmi2Get##name)(fmi2Component c, const fmi2ValueReference which[], size_t count, kind value[]) \
    { \
        for (size_t i = 0; i < count; i++) { \
            const double *from = place(c, which[i], type, 0); \
            if (!from) return fmi2Error; \
            value[i] = (kind)*from; \
        } \
        return fmi2OK; \
    } \
    fmi2Status FMI2(fmi2Set##name)(fmi2Component c, const fmi2ValueReference which[], size_t count, const kind value[]) \
    { \
        for (size_t i = 0; i < count; i++) { \
            double *to = place(c, which[i], type, 1); \
            if (!to) return fmi2Error; \
            *to = (double)value[i]; \
        } \
        return fmi2OK; \
    }
ACCESS(Real, fmi2Real, FMU_REAL)
ACCESS(Integer, fmi2Integer, FMU_INTEGER)
ACCESS(Boolean, fmi2Boolean, FMU_BOOLEAN)

static fmi2Status none(fmi2Component c, size_t count, const char *what)
{
    if (count == 0) return fmi2OK;
    LOG((instance *)c, "this FMU has no %s", what);
    return fmi2Error;
}

fmi2Status FMI2(fmi2GetString)(fmi2Component c, const fmi2ValueReference which[], size_t count, fmi2String value[])
{
    (void)which, (void)value;
    return none(c, count, "text");
}

fmi2Status FMI2(fmi2SetString)(fmi2Component c, const fmi2ValueReference which[], size_t count, const fmi2String value[])
{
    (void)which, (void)value;
    return none(c, count, "text");
}

fmi2Status FMI2(fmi2GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference of[], size_t count, const fmi2ValueReference by[],
                                              size_t counts, const fmi2Real seed[], fmi2Real value[])
{
    (void)of, (void)by, (void)counts, (void)seed, (void)value;
    return none(c, count, "derivatives");
}

fmi2Status FMI2(fmi2SetRealInputDerivatives)(fmi2Component c, const fmi2ValueReference which[], size_t count, const fmi2Integer order[],
                                             const fmi2Real value[])
{
    (void)which, (void)order, (void)value;
    return none(c, count, "derivatives of inputs");
}

fmi2Status FMI2(fmi2GetRealOutputDerivatives)(fmi2Component c, const fmi2ValueReference which[], size_t count, const fmi2Integer order[],
                                              fmi2Real value[])
{
    (void)which, (void)order, (void)value;
    return none(c, count, "derivatives of outputs");
}

/* ---- Saved states ------------------------------------------------------------------------------------------------ */

typedef struct {
    fmu_state state;
    phase phase;
    double begin;
} saved;

fmi2Status FMI2(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *kept)
{
    instance *m = c;
    saved *s = *kept ? *kept : m->calls.allocateMemory(1, sizeof(saved));
    if (!s) return fmi2Error;
    s->state = m->state;
    s->phase = m->phase;
    s->begin = m->begin;
    *kept = s;
    return fmi2OK;
}

fmi2Status FMI2(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate kept)
{
    instance *m = c;
    const saved *s = kept;
    m->state = s->state;
    m->phase = s->phase;
    m->begin = s->begin;
    fmu_moved(&m->state);
    return fmi2OK;
}

fmi2Status FMI2(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *kept)
{
    if (*kept) ((instance *)c)->calls.freeMemory(*kept);
    *kept = NULL;
    return fmi2OK;
}

fmi2Status FMI2(fmi2SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate kept, size_t *size)
{
    (void)c, (void)kept;
    *size = sizeof(saved);
    return fmi2OK;
}

fmi2Status FMI2(fmi2SerializeFMUstate)(fmi2Component c, fmi2FMUstate kept, fmi2Byte bytes[], size_t size)
{
    if (size < sizeof(saved)) return none(c, 1, "state of this size");
    memcpy(bytes, kept, sizeof(saved));
    return fmi2OK;
}

fmi2Status FMI2(fmi2DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *kept)
{
    if (size != sizeof(saved)) return none(c, 1, "state of this size");
    instance *m = c;
    *kept = m->calls.allocateMemory(1, sizeof(saved));
    if (!*kept) return fmi2Error;
    memcpy(*kept, bytes, sizeof(saved));
    return fmi2OK;
}

/* ---- Steps ------------------------------------------------------------------------------------------------------- */

fmi2Status FMI2(fmi2DoStep)(fmi2Component c, fmi2Real now, fmi2Real step, fmi2Boolean kept)
{
    (void)kept;
    instance *m = c;
    double ticks = round(step / FMU_TICK), due = m->begin + (double)m->state.ticks * FMU_TICK;
    if (m->phase != STEPPING) {
        LOG(m, "a step before the initialisation, or after the end");
        return fmi2Error;
    }
    if (!(fabs(step / FMU_TICK - ticks) <= 1e-6 * ticks && ticks >= 1 && ticks <= 1e9)) {
        LOG(m, "step = %.17g s: must be a multiple of the tick, %.17g s", step, FMU_TICK);
        return fmi2Error;
    }
    if (!(fabs(now - due) < FMU_TICK / 2)) {
        LOG(m, "time = %.17g s: the last step ended at %.17g s", now, due);
        return fmi2Error;
    }
    for (int i = 0; i < (int)ticks; i++) {
        const char *wrong = fmu_tick(&m->state, i, (int)ticks);
        if (wrong) {
            LOG(m, "%s: must be finite", wrong);
            return fmi2Error;
        }
        m->state.ticks++;
    }
    return fmi2OK;
}

fmi2Status FMI2(fmi2CancelStep)(fmi2Component c) { return none(c, 1, "step that waits"); }

fmi2Status FMI2(fmi2GetStatus)(fmi2Component c, fmi2StatusKind kind, fmi2Status *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

fmi2Status FMI2(fmi2GetRealStatus)(fmi2Component c, fmi2StatusKind kind, fmi2Real *value)
{
    const instance *m = c;
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = m->begin + (double)m->state.ticks * FMU_TICK;
    return fmi2OK;
}

fmi2Status FMI2(fmi2GetIntegerStatus)(fmi2Component c, fmi2StatusKind kind, fmi2Integer *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

fmi2Status FMI2(fmi2GetBooleanStatus)(fmi2Component c, fmi2StatusKind kind, fmi2Boolean *value)
{
    const instance *m = c;
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = m->phase == TERMINATED;
    return fmi2OK;
}

fmi2Status FMI2(fmi2GetStringStatus)(fmi2Component c, fmi2StatusKind kind, fmi2String *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}
