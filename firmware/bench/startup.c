/* The vector table, the reset handler and the fault handler. */
#include <stddef.h>
#include <stdint.h>

#include "board.h"
#include "nrf52832_regs.h"
#include "ppi_channels.h"

#define STACK_PAINT 0xA5A5A5A5u
#define VECTORS 16u /* the core's own; no interrupt of a peripheral is ever taken */

/* From nrf52832.ld; only the addresses have a meaning. */
extern uint32_t fk_stack_bottom[];
extern uint32_t fk_stack_top[];
extern uint32_t fk_data_begin[];
extern uint32_t fk_data_end[];
extern const uint32_t fk_data_load[];
extern uint32_t fk_bss_begin[];
extern uint32_t fk_bss_end[];

int main(void);
void fk_reset(void);
void fk_fault(void);
void fk_stop(void);
void *memcpy(void *to, const void *from, size_t count);
void *memset(void *to, int value, size_t count);

/* The compiler may turn a copy into a call of one of these, whoever wrote it. The empty asm keeps it from turning
 * their own loops into calls of themselves. */
void *memcpy(void *to, const void *from, size_t count)
{
    uint8_t *out = to;
    const uint8_t *in = from;
    for (size_t i = 0u; i < count; ++i) {
        out[i] = in[i];
        __asm__ volatile("" ::: "memory");
    }
    return to;
}

void *memset(void *to, int value, size_t count)
{
    uint8_t *out = to;
    for (size_t i = 0u; i < count; ++i) {
        out[i] = (uint8_t)value;
        __asm__ volatile("" ::: "memory");
    }
    return to;
}

/* The same under the names of the ARM run-time ABI (RTABI, 4.3.4), which clang calls. The suffix names an
 * alignment, which these functions do not need. */
void __aeabi_memcpy(void *to, const void *from, size_t count);
void __aeabi_memset(void *to, size_t count, int value);
void __aeabi_memclr(void *to, size_t count);
void __aeabi_memcpy4(void *to, const void *from, size_t count) __attribute__((alias("__aeabi_memcpy")));
void __aeabi_memcpy8(void *to, const void *from, size_t count) __attribute__((alias("__aeabi_memcpy")));
void __aeabi_memset4(void *to, size_t count, int value) __attribute__((alias("__aeabi_memset")));
void __aeabi_memset8(void *to, size_t count, int value) __attribute__((alias("__aeabi_memset")));
void __aeabi_memclr4(void *to, size_t count) __attribute__((alias("__aeabi_memclr")));
void __aeabi_memclr8(void *to, size_t count) __attribute__((alias("__aeabi_memclr")));

void __aeabi_memcpy(void *to, const void *from, size_t count) { (void)memcpy(to, from, count); }

void __aeabi_memset(void *to, size_t count, int value) { (void)memset(to, value, count); }

void __aeabi_memclr(void *to, size_t count) { (void)memset(to, 0, count); }

/* No pulse can begin any more, all gates go low, and nothing else happens until the watchdog's reset. */
void fk_stop(void)
{
    PPI_CHENCLR = FK_PPI_PULSE_BEGIN_MASK;
    for (uint32_t limb = 0u; limb < FK_BOARD_LIMBS; ++limb) {
        GPIOTE_TASKS_CLR(limb) = 1u;
    }
    for (;;) {
        __asm__ volatile("");
    }
}

/* A fault of the processor. The stack may be what failed, and compilers save registers there first: so it begins
 * anew. A write to it that fails here would lock the processor up, before anything is switched off. */
__attribute__((naked)) void fk_fault(void)
{
    __asm__ volatile("movw r0, #:lower16:fk_stack_top\n\t"
                     "movt r0, #:upper16:fk_stack_top\n\t"
                     "msr msp, r0\n\t"
                     "b fk_stop");
}

void fk_reset(void)
{
    uint32_t *stack_pointer;
    __asm__ volatile("mov %0, sp" : "=r"(stack_pointer));
    /* Fill the unused stack with a pattern: what differs later was used. */
    for (volatile uint32_t *word = fk_stack_bottom; word < stack_pointer; ++word) {
        *word = STACK_PAINT;
    }
    /* Before the first sleep, and before the watchdog starts its oscillator. */
    CLOCK_ERRATUM_31 = (FICR_ERRATUM_31 >> FK_ERRATUM_31_POS) & FK_ERRATUM_31_MASK;
    CLOCK_ERRATUM_108 = FICR_ERRATUM_108 & FK_ERRATUM_108_MASK;
    /* Before any code that the compiler may have given a float register. */
    SCB_CPACR |= SCB_CPACR_CP10_CP11_Full;
    __asm__ volatile("dsb\n\tisb" ::: "memory");
    const uint32_t *load = fk_data_load;
    for (volatile uint32_t *word = fk_data_begin; word < fk_data_end; ++word) {
        *word = *load;
        ++load;
    }
    for (volatile uint32_t *word = fk_bss_begin; word < fk_bss_end; ++word) {
        *word = 0u;
    }
    (void)main();
    fk_fault(); /* main does not return */
}

typedef void (*fk_handler_t)(void);

typedef struct {
    uint32_t *stack_top;
    fk_handler_t handlers[VECTORS - 1u];
} fk_vectors_t;

__attribute__((section(".vectors"), used)) static const fk_vectors_t vectors = {
    fk_stack_top,
    {fk_reset, fk_fault, fk_fault, fk_fault, fk_fault, fk_fault, fk_fault, fk_fault, fk_fault, fk_fault, fk_fault,
     fk_fault, fk_fault, fk_fault, fk_fault},
};
