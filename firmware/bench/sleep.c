#include "sleep.h"

#include "nrf52832_regs.h"

void fk_sleep_init(void) { SCB_SCR = SCB_SCR_SEVONPEND_Msk; }

void fk_sleep_clear_pending(void)
{
    NVIC_ICPR0 = (1u << POWER_IRQ) | (1u << UARTE0_IRQ) | (1u << TIMER0_IRQ) | (1u << TIMER2_IRQ);
}

#define FPSCR_EXCEPTIONS 0x9Fu
#define FPU_PENDING (1u << (38u - 32u)) /* interrupt 38 */

void fk_sleep(void)
{
    /* A flag of the FPU, as any rounding sets it, keeps its interrupt pending (erratum 87). */
    uint32_t flags;
    __asm__ volatile("vmrs %0, fpscr" : "=r"(flags));
    __asm__ volatile("vmsr fpscr, %0" : : "r"(flags & ~FPSCR_EXCEPTIONS));
    NVIC_ICPR1 = FPU_PENDING;
    /* The first cycles after a wake-up may not reach RAM (erratum 220); no interrupt is taken here. */
    __asm__ volatile("dsb\n\twfe\n\tnop\n\tnop\n\tnop\n\tnop" ::: "memory");
}
