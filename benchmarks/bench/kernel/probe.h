#ifndef TRUESTROKE_PROBE_H
#define TRUESTROKE_PROBE_H
#include "truestroke.h"

/* The loads, stores and multiply-adds of ts_rls_update, without what one of them waits for: the limit of the machine. */
void ts_probe_rls(ts_rls *r, ts_real *w, const ts_real *u, int m);

#endif
