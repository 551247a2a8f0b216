#include "clock.h"

#include "nrf52832_regs.h"

void fk_clock_init(void)
{
    NVMC_ICACHECNF = NVMC_ICACHECNF_CACHEEN_Msk;
    CLOCK_EVENTS_HFCLKSTARTED = 0u;
    CLOCK_TASKS_HFCLKSTART = 1u;
    while (CLOCK_EVENTS_HFCLKSTARTED == 0u) {
    }
    CLOCK_EVENTS_HFCLKSTARTED = 0u;
}
