/* Vector table and start of a Cortex-M with a floating-point unit; newlib's _start does the rest. */
#include <stdint.h>

extern uint32_t __stack_top, __data_load, __data_start, __data_size;
void _start(void);
void reset(void);
void stop(void);

#define CPACR (*(volatile uint32_t *)0xE000ED88u) /* access to coprocessors */

void reset(void)
{
    CPACR |= 0xFu << 20; /* CP10 and CP11: the floating-point unit */
    __asm volatile("dsb\n\tisb");
    __builtin_memcpy(&__data_start, &__data_load, (uint32_t)&__data_size);
    _start();
}

void stop(void)
{
    for (;;) { }
}

typedef union {
    void *stack;
    void (*handler)(void);
} vector;

__attribute__((section(".vectors"), used)) static const vector vectors[16] = {
    {.stack = &__stack_top}, {.handler = reset}, {.handler = stop}, {.handler = stop}, {.handler = stop}, {.handler = stop}, {.handler = stop},
};
