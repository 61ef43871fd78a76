#include "dispatch.h"

#include <string.h>

extern const ts_variant ts_variant_plain, ts_variant_vector, ts_variant_avx2;

/* TS_X86: the variant for AVX2 was compiled. A compiler that cannot ask the processor uses the others, and so does the
 * half for ARM of a library for both. */
#if defined(TS_X86) && defined(__GNUC__) && defined(__x86_64__)
static const ts_variant *const variants[] = {&ts_variant_plain, &ts_variant_vector, &ts_variant_avx2};

static int supported(void) { return __builtin_cpu_supports("avx2") ? 3 : 2; }
#else
static const ts_variant *const variants[] = {&ts_variant_plain, &ts_variant_vector}; /* NEON is in every 64-bit ARM */

static int supported(void) { return 2; }
#endif

static const ts_variant *in_use = &ts_variant_plain;

const char *ts_variant_name(int i) { return i >= 0 && i < supported() ? variants[i]->name : NULL; }
const char *ts_variant_in_use(void) { return in_use->name; }

bool ts_variant_use(const char *name)
{
    for (int i = supported() - 1; i >= 0; i--)
        if (!name || strcmp(name, variants[i]->name) == 0) {
            in_use = variants[i];
            return true;
        }
    return false;
}

#define VALUE(type, name, parameters, arguments) \
    type name parameters { return in_use->name arguments; }
#define NOTHING(name, parameters, arguments) \
    void name parameters { in_use->name arguments; }
TS_FUNCTIONS(VALUE, NOTHING)
