/* The kernel and the simulated plant as one WebAssembly module: what web/truestroke.js calls.
 *
 * The caller owns the memory: it asks for sizes, and lays structs out from `__heap_base` on. Settings are written by the
 * names of their members, as `truestroke export json` lists them.
 */
#include <stddef.h>
#include <string.h>

#include "plant.h"
#include "status.h"
#include "truestroke.h"

#define EXPORT(name) __attribute__((export_name(#name), used)) name

extern unsigned char __heap_base; /* the linker's: memory from here on is free */
void *EXPORT(heap)(void) { return &__heap_base; }

/* ---- Settings by name -------------------------------------------------------------------------------------------- */

typedef enum { REAL, INTEGER, BYTE, TRUTH, TICK } kind;

/* The type of a member or of its entries, and how many entries are in a row of a table. */
#define KIND(x) _Generic((x), double: REAL, double *: REAL, double (*)[3]: REAL, double (*)[4]: REAL, double (*)[5]: REAL, int: INTEGER, int *: INTEGER, \
                         unsigned char *: BYTE, ts_law: INTEGER, _Bool: TRUTH, _Bool *: TRUTH, uint64_t: TICK)
#define COLUMNS(x) _Generic((x), double (*)[3]: 3, double (*)[4]: 4, double (*)[5]: 5, default: 1)
#define WIDTH(k) ((k) == TRUTH ? sizeof(_Bool) : (k) == BYTE ? 1 : (k) == INTEGER ? sizeof(int) : 8)

typedef struct {
    const char *name;
    size_t offset, bytes, columns;
    kind of;
} member;

#define MEMBER(name, path) {name, offsetof(OF, path), sizeof ((OF *)0)->path, COLUMNS(((OF *)0)->path), KIND(((OF *)0)->path)},
#define OF ts_settings
static const member controller_members[] = {
#include "ts_settings.inc"
};
#undef OF
#define OF ts_plant_settings
static const member plant_members[] = {
#include "ts_plant_settings.inc"
};

static int same(const char *a, const char *b)
{
    while (*a && *a == *b) a++, b++;
    return *a == *b;
}

/* A whole number; what is no number, or beyond the type, is the nearest that the type has. */
static uint64_t whole(double value)
{
    return value >= 18446744073709551615.0 ? UINT64_MAX : value > 0 ? (uint64_t)value : 0;
}

static int written(const member *members, size_t count, void *settings, const char *name, size_t row, size_t column, double value)
{
    for (const member *m = members; m < members + count; m++) {
        if (!same(m->name, name)) continue;
        size_t width = WIDTH(m->of), index = row * m->columns + column;
        if (column >= m->columns || row >= m->bytes / width / m->columns) return 0;
        char *place = (char *)settings + m->offset + index * width;
        switch (m->of) {
            case REAL: *(double *)place = value; break;
            case INTEGER: *(int *)place = (int)value; break;
            case BYTE: *(unsigned char *)place = (unsigned char)value; break;
            case TRUTH: *(_Bool *)place = value != 0; break;
            case TICK: *(uint64_t *)place = whole(value); break;
        }
        return 1;
    }
    return 0;
}

/* An entry of the member `name`, in a row of a table or else in column 0; 0 where the settings have none. */
int EXPORT(controller_set)(ts_settings *s, const char *name, size_t row, size_t column, double value)
{
    return written(controller_members, sizeof controller_members / sizeof *controller_members, s, name, row, column, value);
}

int EXPORT(plant_set)(ts_plant_settings *s, const char *name, size_t row, size_t column, double value)
{
    return written(plant_members, sizeof plant_members / sizeof *plant_members, s, name, row, column, value);
}

size_t EXPORT(controller_settings_bytes)(void) { return sizeof(ts_settings); }
size_t EXPORT(plant_settings_bytes)(void) { return sizeof(ts_plant_settings); }

/* ---- The controller ---------------------------------------------------------------------------------------------- */

size_t EXPORT(controller_bytes)(void) { return sizeof(ts_controller); }
const char *EXPORT(status_setting)(ts_status status) { return ts_status_setting(status); }
ts_status EXPORT(controller_init)(ts_controller *c, const ts_settings *s) { return ts_controller_init(c, s); }
void EXPORT(controller_point)(ts_controller *c, const ts_settings *s) { c->settings = s; }
ts_status EXPORT(controller_start)(ts_controller *c, double volts, double z) { return ts_controller_start(c, volts, z); }
ts_status EXPORT(controller_adapt)(ts_controller *c, double z, int ago) { return ts_controller_adapt(c, z, ago); }
void EXPORT(controller_hold)(ts_controller *c, int hold) { ts_controller_hold(c, hold != 0); }

ts_status EXPORT(controller_follow)(ts_controller *c, double z_d, double zdot_d, double zddot_d, double strain_d, double *volts)
{
    return ts_controller_follow(c, z_d, zdot_d, zddot_d, strain_d, NULL, volts);
}

/* Bit i is member i of ts_flags. */
unsigned EXPORT(controller_flags)(const ts_controller *c)
{
    const bool *flag = (const bool *)&c->flags;
    unsigned bits = 0;
    for (unsigned i = 0; i < sizeof c->flags / sizeof(bool); i++) bits |= (unsigned)flag[i] << i;
    return bits;
}

double EXPORT(controller_innovation)(const ts_controller *c) { return c->innovation; }
int EXPORT(controller_parameters)(const ts_controller *c) { return c->parameters; }
const double *EXPORT(controller_weights)(const ts_controller *c) { return c->w; }
int EXPORT(controller_plays)(const ts_controller *c) { return c->settings->plays; }
const double *EXPORT(controller_slopes)(const ts_controller *c) { return c->slopes; }

/* ---- The simulated stack ----------------------------------------------------------------------------------------- */

size_t EXPORT(plant_bytes)(void) { return sizeof(ts_plant); }
void EXPORT(plant_init)(ts_plant *p, const ts_plant_settings *s) { ts_plant_init(p, s); }

void EXPORT(plant_run)(ts_plant *p, const double *volts, const double *noise, double *measured, double *truth, size_t ticks)
{
    ts_plant_run(p, volts, noise, measured, truth, ticks);
}

/* Other settings while it moves: the voltage, the plays, what has crept and the motion of the stage stay. */
void EXPORT(plant_change)(ts_plant *p, const ts_plant_settings *s)
{
    ts_plant before = *p;
    ts_plant_init(p, s);
    p->tick = before.tick;
    p->volts = before.volts;
    memcpy(p->play, before.play, sizeof p->play);
    memcpy(p->creep, before.creep, sizeof p->creep);
    p->crept = before.crept;
    p->position = before.position;
    p->velocity = before.velocity;
}

double EXPORT(plant_tick)(const ts_plant *p) { return (double)p->tick; }
