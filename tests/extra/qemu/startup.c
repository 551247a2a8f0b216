/* From reset to main on QEMU's mps2-an386; output on its UART0, end by semihosting.
 * With FK_LEAVE_FPU_OFF the FPU stays as reset leaves it, and the first float instruction must fault. */
#include <stddef.h>
#include <stdint.h>

#include "startup.h"

#define SCB_CFSR (*(volatile uint32_t *)0xE000ED28u)  /* ARMv7-M, B3.2.15 */
#define SCB_CPACR (*(volatile uint32_t *)0xE000ED88u) /* ARMv7-M, B3.2.20 */
#define CPACR_CP10_CP11_FULL (0xFu << 20)

/* CMSDK APB UART 0 (Arm DDI 0479, 4.3). */
#define UART_DATA (*(volatile uint32_t *)0x40004000u)
#define UART_STATE (*(volatile uint32_t *)0x40004004u)
#define UART_CTRL (*(volatile uint32_t *)0x40004008u)
#define UART_BAUDDIV (*(volatile uint32_t *)0x40004010u)
#define UART_STATE_TX_FULL 1u
#define UART_CTRL_TX_ENABLE 1u
#define UART_BAUDDIV_LEAST 16u

#define SEMIHOSTING_EXIT_EXTENDED 0x20u
#define SEMIHOSTING_STOPPED_APPLICATION_EXIT 0x20026u

#define VECTORS 16u

/* From board.ld; only their addresses mean something. */
extern uint32_t fk_stack_top[];
extern uint32_t fk_bss_begin[];
extern uint32_t fk_bss_end[];

int main(void);
void fk_reset(void);
void fk_fault(void);
void *memcpy(void *to, const void *from, size_t count);
void *memset(void *to, int value, size_t count);

/* The compiler may turn a copy into a call of one of these. The empty asm keeps it from turning their own loops
 * into calls of themselves. */
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

static void put_byte(char byte)
{
    while ((UART_STATE & UART_STATE_TX_FULL) != 0u) {
    }
    UART_DATA = (uint32_t)(uint8_t)byte;
}

void fk_put_text(const char *text)
{
    while (*text != '\0') {
        put_byte(*text);
        ++text;
    }
}

void fk_put_word(uint32_t word, char after)
{
    for (uint32_t shift = 32u; shift > 0u; shift -= 4u) {
        put_byte("0123456789abcdef"[(word >> (shift - 4u)) & 0xFu]);
    }
    put_byte(after);
}

static void leave(uint32_t exit_code)
{
    const uint32_t block[2] = {SEMIHOSTING_STOPPED_APPLICATION_EXIT, exit_code};
    for (;;) {
        register uint32_t operation __asm__("r0") = SEMIHOSTING_EXIT_EXTENDED;
        register const uint32_t *argument __asm__("r1") = block;
        __asm__ volatile("bkpt 0xAB" : "+r"(operation) : "r"(argument) : "memory");
    }
}

/* No float instruction here: this runs where the FPU is off. */
void fk_fault(void)
{
    fk_put_text("fault ");
    fk_put_word(SCB_CFSR, '\n');
    leave(FK_EXIT_FAULT);
}

void fk_reset(void)
{
    UART_BAUDDIV = UART_BAUDDIV_LEAST;
    UART_CTRL = UART_CTRL_TX_ENABLE;
#ifndef FK_LEAVE_FPU_OFF
    SCB_CPACR |= CPACR_CP10_CP11_FULL;
    __asm__ volatile("dsb\n\tisb" ::: "memory");
#endif
    for (volatile uint32_t *word = fk_bss_begin; word != fk_bss_end; ++word) {
        *word = 0u;
    }
    leave((uint32_t)main());
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
