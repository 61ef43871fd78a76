/* FMI 3.0 for co-simulation around a unit (unit.h). */
#include "fmi3.h"

#include <stdlib.h>
#include <string.h>

typedef struct {
    fmu_instance unit;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} instance;

/* The status of a call that was good, or else has said why not. */
static fmi3Status told(instance *m, bool good)
{
    if (!good && m->log) m->log(m->environment, fmi3Error, "logStatusError", m->unit.said);
    return good ? fmi3OK : fmi3Error;
}

static fmi3Status none(fmi3Instance c, const char *what)
{
    instance *m = c;
    return told(m, fmu_has_no(&m->unit, what));
}

/* ---- Life -------------------------------------------------------------------------------------------------------- */

fmi3String FMI3(fmi3GetVersion)(void) { return "3.0"; }

fmi3Instance FMI3(fmi3InstantiateCoSimulation)(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[], size_t count,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)required, (void)count, (void)update;
    instance *m = calloc(1, sizeof *m);
    if (!m) return NULL;
    m->environment = environment;
    m->log = log;
    fmu_reset(&m->unit);
    if (told(m, fmu_is(&m->unit, token)) == fmi3OK) return m;
    free(m);
    return NULL;
}

static fmi3Instance co_simulation_only(fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    if (log) log(environment, fmi3Error, "logStatusError", "this FMU is for co-simulation");
    return NULL;
}

fmi3Instance FMI3(fmi3InstantiateModelExchange)(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
                                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    return co_simulation_only(environment, log);
}

fmi3Instance FMI3(fmi3InstantiateScheduledExecution)(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                                     fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                     fmi3ClockUpdateCallback update, fmi3PreemptionCallback lock, fmi3PreemptionCallback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)update, (void)lock, (void)unlock;
    return co_simulation_only(environment, log);
}

void FMI3(fmi3FreeInstance)(fmi3Instance c) { free(c); }

fmi3Status FMI3(fmi3SetDebugLogging)(fmi3Instance c, fmi3Boolean on, size_t count, const fmi3String categories[])
{
    (void)c, (void)on, (void)count, (void)categories;
    return fmi3OK;
}

fmi3Status FMI3(fmi3EnterInitializationMode)(fmi3Instance c, fmi3Boolean given, fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean ends,
                                             fmi3Float64 stop)
{
    (void)given, (void)tolerance, (void)ends, (void)stop;
    fmu_saved *now = &((instance *)c)->unit.now;
    now->phase = FMU_INITIALISING;
    now->begin = start;
    return fmi3OK;
}

fmi3Status FMI3(fmi3ExitInitializationMode)(fmi3Instance c)
{
    instance *m = c;
    return told(m, fmu_start(&m->unit));
}

fmi3Status FMI3(fmi3Terminate)(fmi3Instance c)
{
    ((instance *)c)->unit.now.phase = FMU_TERMINATED;
    return fmi3OK;
}

fmi3Status FMI3(fmi3Reset)(fmi3Instance c)
{
    fmu_reset(&((instance *)c)->unit);
    return fmi3OK;
}

/* ---- Values ------------------------------------------------------------------------------------------------------ */

/* Reads a variable, or the time, which has the number behind the last variable. */
static bool value_of(instance *m, fmi3ValueReference which, fmu_type type, double *value)
{
    bool time = which == FMU_VARIABLES && type == FMU_REAL;
    const double *from = time ? NULL : fmu_place(&m->unit, which, type, false);
    if (time || from) *value = time ? fmu_time(&m->unit) : *from;
    return time || from;
}

#define ACCESS(name, type) \
    fmi3Status FMI3(fmi3Get##name)(fmi3Instance c, const fmi3ValueReference which[], size_t count, fmi3##name value[], size_t values) \
    { \
        double found = 0; \
        for (size_t i = 0; i < count && i < values; i++) { \
            if (!value_of(c, which[i], type, &found)) return told(c, false); \
            value[i] = (fmi3##name)found; \
        } \
        return fmi3OK; \
    } \
    fmi3Status FMI3(fmi3Set##name)(fmi3Instance c, const fmi3ValueReference which[], size_t count, const fmi3##name value[], size_t values) \
    { \
        instance *m = c; \
        for (size_t i = 0; i < count && i < values; i++) { \
            double *to = fmu_place(&m->unit, which[i], type, true); \
            if (!to) return told(m, false); \
            *to = (double)value[i]; \
        } \
        return fmi3OK; \
    }
ACCESS(Float64, FMU_REAL)
ACCESS(Int32, FMU_INTEGER)
ACCESS(Boolean, FMU_BOOLEAN)

/* ---- Saved states ------------------------------------------------------------------------------------------------ */

fmi3Status FMI3(fmi3GetFMUState)(fmi3Instance c, fmi3FMUState *kept)
{
    fmu_saved *s = *kept ? *kept : calloc(1, sizeof *s);
    if (!s) return fmi3Error;
    *s = ((instance *)c)->unit.now;
    *kept = s;
    return fmi3OK;
}

fmi3Status FMI3(fmi3SetFMUState)(fmi3Instance c, fmi3FMUState kept)
{
    fmu_restore(&((instance *)c)->unit, kept);
    return fmi3OK;
}

fmi3Status FMI3(fmi3FreeFMUState)(fmi3Instance c, fmi3FMUState *kept)
{
    (void)c;
    free(*kept);
    *kept = NULL;
    return fmi3OK;
}

fmi3Status FMI3(fmi3SerializedFMUStateSize)(fmi3Instance c, fmi3FMUState kept, size_t *size)
{
    (void)c, (void)kept;
    *size = sizeof(fmu_saved);
    return fmi3OK;
}

fmi3Status FMI3(fmi3SerializeFMUState)(fmi3Instance c, fmi3FMUState kept, fmi3Byte bytes[], size_t size)
{
    if (size < sizeof(fmu_saved)) return none(c, "state of this size");
    memcpy(bytes, kept, sizeof(fmu_saved));
    return fmi3OK;
}

fmi3Status FMI3(fmi3DeserializeFMUState)(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *kept)
{
    if (size != sizeof(fmu_saved)) return none(c, "state of this size");
    if (!*kept) *kept = calloc(1, sizeof(fmu_saved));
    if (!*kept) return fmi3Error;
    memcpy(*kept, bytes, sizeof(fmu_saved));
    return fmi3OK;
}

/* ---- Steps ------------------------------------------------------------------------------------------------------- */

fmi3Status FMI3(fmi3EnterStepMode)(fmi3Instance c)
{
    (void)c;
    return fmi3OK;
}

fmi3Status FMI3(fmi3DoStep)(fmi3Instance c, fmi3Float64 now, fmi3Float64 step, fmi3Boolean kept, fmi3Boolean *event, fmi3Boolean *terminate,
                            fmi3Boolean *early, fmi3Float64 *reached)
{
    (void)kept;
    instance *m = c;
    bool good = fmu_step(&m->unit, now, step);
    *event = *terminate = *early = false;
    *reached = fmu_time(&m->unit);
    return told(m, good);
}

/* ---- What there is not: the specification asks for all of its functions ------------------------------------------------ */

#define OTHER(name) \
    fmi3Status FMI3(fmi3Get##name)(fmi3Instance c, const fmi3ValueReference which[], size_t count, fmi3##name value[], size_t values) \
    { \
        (void)which, (void)value, (void)values; \
        return count == 0 ? fmi3OK : none(c, "variables of type " #name); \
    } \
    fmi3Status FMI3(fmi3Set##name)(fmi3Instance c, const fmi3ValueReference which[], size_t count, const fmi3##name value[], size_t values) \
    { \
        (void)which, (void)value, (void)values; \
        return count == 0 ? fmi3OK : none(c, "variables of type " #name); \
    }
OTHER(Float32) OTHER(Int8) OTHER(UInt8) OTHER(Int16) OTHER(UInt16) OTHER(UInt32) OTHER(Int64) OTHER(UInt64) OTHER(String)

/* A call that fails: its name, its arguments behind the instance, and what there is not. */
#define NONE(name, arguments, what) \
    fmi3Status FMI3(fmi3##name) arguments { return none(c, what); }
#define WHICH fmi3Instance c, const fmi3ValueReference v[], size_t n

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
NONE(GetBinary, (WHICH, size_t sizes[], fmi3Binary value[], size_t values), "variables of type Binary")
NONE(SetBinary, (WHICH, const size_t sizes[], const fmi3Binary value[], size_t values), "variables of type Binary")
NONE(GetClock, (WHICH, fmi3Clock value[]), "clocks")
NONE(SetClock, (WHICH, const fmi3Clock value[]), "clocks")
NONE(GetIntervalDecimal, (WHICH, fmi3Float64 a[], fmi3IntervalQualifier q[]), "clocks")
NONE(GetIntervalFraction, (WHICH, fmi3UInt64 a[], fmi3UInt64 b[], fmi3IntervalQualifier q[]), "clocks")
NONE(GetShiftDecimal, (WHICH, fmi3Float64 a[]), "clocks")
NONE(GetShiftFraction, (WHICH, fmi3UInt64 a[], fmi3UInt64 b[]), "clocks")
NONE(SetIntervalDecimal, (WHICH, const fmi3Float64 a[]), "clocks")
NONE(SetIntervalFraction, (WHICH, const fmi3UInt64 a[], const fmi3UInt64 b[]), "clocks")
NONE(SetShiftDecimal, (WHICH, const fmi3Float64 a[]), "clocks")
NONE(SetShiftFraction, (WHICH, const fmi3UInt64 a[], const fmi3UInt64 b[]), "clocks")
NONE(ActivateModelPartition, (fmi3Instance c, fmi3ValueReference v, fmi3Float64 time), "clocks")
NONE(GetNumberOfVariableDependencies, (fmi3Instance c, fmi3ValueReference v, size_t *n), "dependencies")
NONE(GetVariableDependencies, (fmi3Instance c, fmi3ValueReference v, size_t a[], fmi3ValueReference b[], size_t d[], fmi3DependencyKind k[],
                               size_t n), "dependencies")
NONE(GetDirectionalDerivative, (WHICH, const fmi3ValueReference by[], size_t m, const fmi3Float64 seed[], size_t seeds, fmi3Float64 value[],
                                size_t values), "derivatives")
NONE(GetAdjointDerivative, (WHICH, const fmi3ValueReference by[], size_t m, const fmi3Float64 seed[], size_t seeds, fmi3Float64 value[],
                            size_t values), "derivatives")
NONE(GetOutputDerivatives, (WHICH, const fmi3Int32 orders[], fmi3Float64 value[], size_t values), "derivatives")
NONE(EnterConfigurationMode, (fmi3Instance c), "structural parameters")
NONE(ExitConfigurationMode, (fmi3Instance c), "structural parameters")
NONE(EnterEventMode, (fmi3Instance c), "events")
NONE(EvaluateDiscreteStates, (fmi3Instance c), "events")
NONE(UpdateDiscreteStates, (fmi3Instance c, fmi3Boolean *needed, fmi3Boolean *terminate, fmi3Boolean *nominals, fmi3Boolean *states,
                            fmi3Boolean *defined, fmi3Float64 *next), "events")
NONE(EnterContinuousTimeMode, (fmi3Instance c), "continuous states")
NONE(CompletedIntegratorStep, (fmi3Instance c, fmi3Boolean kept, fmi3Boolean *event, fmi3Boolean *terminate), "continuous states")
NONE(SetTime, (fmi3Instance c, fmi3Float64 time), "continuous states")
NONE(SetContinuousStates, (fmi3Instance c, const fmi3Float64 x[], size_t n), "continuous states")
NONE(GetContinuousStates, (fmi3Instance c, fmi3Float64 x[], size_t n), "continuous states")
NONE(GetContinuousStateDerivatives, (fmi3Instance c, fmi3Float64 x[], size_t n), "continuous states")
NONE(GetNominalsOfContinuousStates, (fmi3Instance c, fmi3Float64 x[], size_t n), "continuous states")
NONE(GetEventIndicators, (fmi3Instance c, fmi3Float64 x[], size_t n), "continuous states")

fmi3Status FMI3(fmi3GetNumberOfEventIndicators)(fmi3Instance c, size_t *count)
{
    (void)c;
    *count = 0;
    return fmi3OK;
}

fmi3Status FMI3(fmi3GetNumberOfContinuousStates)(fmi3Instance c, size_t *count)
{
    (void)c;
    *count = 0;
    return fmi3OK;
}
