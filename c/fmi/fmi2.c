/* FMI 2.0 for co-simulation around a unit (unit.h). */
#include "fmi2.h"

#include <stdio.h>
#include <string.h>

#include "instance.h"

typedef struct {
    fmu_instance unit;
    fmi2CallbackFunctions calls;
    char name[64];
} instance;

/* The status of a call that was good, or else has said why not. */
static fmi2Status told(instance *m, bool good)
{
    if (!good && m->calls.logger)
        m->calls.logger(m->calls.componentEnvironment, m->name, fmi2Error, "logStatusError", m->unit.said);
    return good ? fmi2OK : fmi2Error;
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
    fmu_reset(&m->unit);
    if (told(m, fmu_is(&m->unit, guid)) == fmi2OK) return m;
    calls->freeMemory(m);
    return NULL;
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
    ((instance *)c)->unit.now.begin = start;
    return fmi2OK;
}

fmi2Status FMI2(fmi2EnterInitializationMode)(fmi2Component c)
{
    ((instance *)c)->unit.now.phase = FMU_INITIALISING;
    return fmi2OK;
}

fmi2Status FMI2(fmi2ExitInitializationMode)(fmi2Component c)
{
    instance *m = c;
    return told(m, fmu_start(&m->unit));
}

fmi2Status FMI2(fmi2Terminate)(fmi2Component c)
{
    ((instance *)c)->unit.now.phase = FMU_TERMINATED;
    return fmi2OK;
}

fmi2Status FMI2(fmi2Reset)(fmi2Component c)
{
    fmu_reset(&((instance *)c)->unit);
    return fmi2OK;
}

/* ---- Values ------------------------------------------------------------------------------------------------------ */

#define ACCESS(name, kind, type) \
    fmi2Status FMI2(fmi2Get##name)(fmi2Component c, const fmi2ValueReference which[], size_t count, kind value[]) \
    { \
        instance *m = c; \
        for (size_t i = 0; i < count; i++) { \
            const double *from = fmu_place(&m->unit, which[i], type, false); \
            if (!from) return told(m, false); \
            value[i] = (kind)*from; \
        } \
        return fmi2OK; \
    } \
    fmi2Status FMI2(fmi2Set##name)(fmi2Component c, const fmi2ValueReference which[], size_t count, const kind value[]) \
    { \
        instance *m = c; \
        for (size_t i = 0; i < count; i++) { \
            double *to = fmu_place(&m->unit, which[i], type, true); \
            if (!to) return told(m, false); \
            *to = (double)value[i]; \
        } \
        return fmi2OK; \
    }
ACCESS(Real, fmi2Real, FMU_REAL)
ACCESS(Integer, fmi2Integer, FMU_INTEGER)
ACCESS(Boolean, fmi2Boolean, FMU_BOOLEAN)

static fmi2Status none(fmi2Component c, size_t count, const char *what)
{
    instance *m = c;
    return count == 0 ? fmi2OK : told(m, fmu_has_no(&m->unit, what));
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

fmi2Status FMI2(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *kept)
{
    instance *m = c;
    fmu_saved *s = *kept ? *kept : m->calls.allocateMemory(1, sizeof(fmu_saved));
    if (!s) return fmi2Error;
    *s = m->unit.now;
    *kept = s;
    return fmi2OK;
}

fmi2Status FMI2(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate kept)
{
    fmu_restore(&((instance *)c)->unit, kept);
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
    *size = sizeof(fmu_saved);
    return fmi2OK;
}

fmi2Status FMI2(fmi2SerializeFMUstate)(fmi2Component c, fmi2FMUstate kept, fmi2Byte bytes[], size_t size)
{
    if (size < sizeof(fmu_saved)) return none(c, 1, "state of this size");
    memcpy(bytes, kept, sizeof(fmu_saved));
    return fmi2OK;
}

fmi2Status FMI2(fmi2DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *kept)
{
    if (size != sizeof(fmu_saved)) return none(c, 1, "state of this size");
    instance *m = c;
    *kept = m->calls.allocateMemory(1, sizeof(fmu_saved));
    if (!*kept) return fmi2Error;
    memcpy(*kept, bytes, sizeof(fmu_saved));
    return fmi2OK;
}

/* ---- Steps ------------------------------------------------------------------------------------------------------- */

fmi2Status FMI2(fmi2DoStep)(fmi2Component c, fmi2Real now, fmi2Real step, fmi2Boolean kept)
{
    (void)kept;
    instance *m = c;
    return told(m, fmu_step(&m->unit, now, step));
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
    *value = fmu_time(&m->unit);
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
    *value = m->unit.now.phase == FMU_TERMINATED;
    return fmi2OK;
}

fmi2Status FMI2(fmi2GetStringStatus)(fmi2Component c, fmi2StatusKind kind, fmi2String *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}
