#include "watchdog.h"

#include "fk_frames_layout.h"
#include "nrf52832_regs.h"

/* The watchdog's RC oscillator may be 2 % slow, so that 980 ms of its time take up to 1 s. */
#define WATCHDOG_TICKS_PER_S 32768u
#define WATCHDOG_TICKS (WATCHDOG_TICKS_PER_S / 100u * 98u)

uint8_t fk_watchdog_reset_reason(void)
{
    uint32_t reasons = POWER_RESETREAS;
    POWER_RESETREAS = reasons; /* reasons accumulate until ones are written */
    /* Tested first: with a pin reset other reasons may be set wrongly (erratum 136). */
    if ((reasons & POWER_RESETREAS_RESETPIN_Msk) != 0u) {
        return FK_RESET_PIN;
    }
    if ((reasons & POWER_RESETREAS_DOG_Msk) != 0u) {
        return FK_RESET_WATCHDOG;
    }
    if ((reasons & POWER_RESETREAS_LOCKUP_Msk) != 0u) {
        return FK_RESET_LOCKUP;
    }
    if ((reasons & POWER_RESETREAS_SREQ_Msk) != 0u) {
        return FK_RESET_SOFTWARE;
    }
    return (reasons == 0u) ? FK_RESET_POWER : FK_RESET_UNKNOWN;
}

void fk_watchdog_init(void)
{
    WDT_CONFIG = WDT_CONFIG_SLEEP_Run << WDT_CONFIG_SLEEP_Pos;
    WDT_CRV = WATCHDOG_TICKS - 1u;
    WDT_RREN = WDT_RREN_RR0_Msk;
    WDT_TASKS_START = 1u;
}

void fk_watchdog_feed(void) { WDT_RR(0u) = WDT_RR_RR_Reload; }
