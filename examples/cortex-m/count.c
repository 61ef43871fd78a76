/* The self-test with the instructions of each tick counted: QEMU with -icount shift=0 takes 1 ns for each, SysTick counts
 * cycles of 40 ns. On a board it counts cycles of the core. */
#define board_wait replay_wait
#include "replay.c"
#undef board_wait

#include <stdint.h>

#define CONTROL (*(volatile uint32_t *)0xE000E010u)
#define RELOAD (*(volatile uint32_t *)0xE000E014u)
#define VALUE (*(volatile uint32_t *)0xE000E018u)

#ifndef PER_COUNT
#define PER_COUNT 40 /* instructions */
#endif

bool board_wait(void)
{
    static uint32_t before, worst;
    static double sum;
    static int counted;
    uint32_t now = VALUE, taken = ((before - now) & 0xFFFFFFu) * PER_COUNT;
    if (tick > 0) {
        sum += taken;
        counted++;
        if (taken > worst) worst = taken;
    }
    if (tick == TICKS - 1) printf("instructions per tick: mean %.0f, most %lu\n", sum / counted, (unsigned long)worst);
    bool more = replay_wait();
    CONTROL = 0;
    RELOAD = 0xFFFFFFu;
    VALUE = 0;
    CONTROL = 5;
    before = VALUE;
    return more;
}
