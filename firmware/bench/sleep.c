#include "sleep.h"

#include "nrf52832_regs.h"

void fk_sleep_init(void) { SCB_SCR = SCB_SCR_SEVONPEND_Msk; }

void fk_sleep_clear_pending(void)
{
    NVIC_ICPR0 = (1u << POWER_IRQ) | (1u << UARTE0_IRQ) | (1u << TIMER0_IRQ) | (1u << TIMER2_IRQ);
}

void fk_sleep(void) { __asm__ volatile("dsb\n\twfe" ::: "memory"); }
