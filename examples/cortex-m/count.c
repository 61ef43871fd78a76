/* The self-test with the instructions of each tick counted, from the timer to the voltage: QEMU with -icount shift=0 takes 1 ns for each,
 * SysTick counts cycles of 40 ns. On a board it counts cycles of the core. */
#define board_wait replay_wait
#define board_write replay_write
#include "replay.c"
#undef board_wait
#undef board_write

#include <stdint.h>

#define CONTROL (*(volatile uint32_t *)0xE000E010u)
#define RELOAD (*(volatile uint32_t *)0xE000E014u)
#define VALUE (*(volatile uint32_t *)0xE000E018u)

#ifndef PER_COUNT
#define PER_COUNT 40 /* instructions */
#endif

static uint32_t before, worst, sum;

bool board_wait(void)
{
    if (tick == TICKS - 1)
        printf("instructions per tick: mean %lu, most %lu\n", (unsigned long)(sum / TICKS), (unsigned long)worst);
    bool more = replay_wait();
    CONTROL = 0;
    RELOAD = 0xFFFFFFu;
    VALUE = 0;
    CONTROL = 5;
    before = VALUE;
    return more;
}

void board_write(ts_real volts)
{
    uint32_t taken = ((before - VALUE) & 0xFFFFFFu) * PER_COUNT;
    replay_write(volts);
    if (tick < 0) return; /* the voltage of the start */
    sum += taken;
    if (taken > worst) worst = taken;
}
