/* The whole kernel as one variant: compiled once for each instruction set, with -DTS_VARIANT=its name. */
#define TS_API static

#include "../src/operators.c"
#include "../src/inverse.c"
#include "../src/rls.c"
#include "../src/kalman.c"
#include "../src/oscillation.c"
#include "../src/guard.c"
#include "../src/tone.c"
#include "../src/resonance.c"
#include "../src/check.c"
#include "../src/terms.c"
#include "../src/dynamics.c"
#include "../src/hum.c"
#include "../src/command.c"
#include "../src/candidate.c"
#include "../src/found.c"
#include "../src/ringing.c"
#include "../src/learned.c"
#include "../src/adapt.c"
#include "../src/controller.c"
#include "../src/repetition.c"

#include "dispatch.h"

#define NAME_OF(variant) #variant
#define NAME(variant) NAME_OF(variant)
#define TABLE_OF(variant) ts_variant_##variant
#define TABLE(variant) TABLE_OF(variant)
#define VALUE(type, name, parameters, arguments) name,
#define NOTHING(name, parameters, arguments) name,

extern const ts_variant TABLE(TS_VARIANT);
const ts_variant TABLE(TS_VARIANT) = {NAME(TS_VARIANT), TS_FUNCTIONS(VALUE, NOTHING)};
