#include "clock.h"

#include "nrf52832_regs.h"

/* Reads of the event, each six cycles at least: 4 ms, where a crystal takes 0.4 ms. No timer runs yet. */
#define STARTED_READS 50000u

#define CRYSTAL_RUNS (CLOCK_HFCLKSTAT_SRC_Msk | CLOCK_HFCLKSTAT_STATE_Msk)

void fk_clock_init(void)
{
    NVMC_ICACHECNF = NVMC_ICACHECNF_CACHEEN_Msk;
    CLOCK_EVENTS_HFCLKSTARTED = 0u;
    CLOCK_TASKS_HFCLKSTART = 1u;
    for (uint32_t reads = 0u; CLOCK_EVENTS_HFCLKSTARTED == 0u && reads < STARTED_READS; ++reads) {
    }
    CLOCK_EVENTS_HFCLKSTARTED = 0u;
}

int32_t fk_clock_is_exact(void) { return (CLOCK_HFCLKSTAT & CRYSTAL_RUNS) == CRYSTAL_RUNS; }
