#include "supply.h"

#include "board.h"
#include "nrf52832_regs.h"
#include "time.h"

/* The power-fail comparator reports a supply that falls, not one that has recovered. So it is switched off and on
 * again, and where it reports nothing for this long, the supply is sufficient. */
#define SETTLED_US 1000u

#define SWITCHED_OFF (FK_BOARD_SUPPLY_LEAST << POWER_POFCON_THRESHOLD_Pos)
#define SWITCHED_ON (SWITCHED_OFF | (POWER_POFCON_POF_Enabled << POWER_POFCON_POF_Pos))

static uint8_t is_low;
static uint8_t is_asked;
static uint64_t asked_us;

void fk_supply_init(void)
{
    is_low = 0u;
    is_asked = 0u;
    POWER_EVENTS_POFWARN = 0u;
    POWER_INTENSET = POWER_INTENSET_POFWARN_Msk;
    POWER_POFCON = SWITCHED_ON;
}

int32_t fk_supply_is_low(void)
{
    if (POWER_EVENTS_POFWARN != 0u) {
        POWER_EVENTS_POFWARN = 0u;
        (void)POWER_EVENTS_POFWARN; /* the write has arrived before the caller goes on */
        is_low = 1u;
        is_asked = 0u;
    } else if (is_low != 0u && is_asked == 0u) {
        POWER_POFCON = SWITCHED_OFF;
        POWER_POFCON = SWITCHED_ON;
        asked_us = fk_time_now_us();
        is_asked = 1u;
    } else if (is_low != 0u && fk_time_now_us() - asked_us >= SETTLED_US) {
        is_low = 0u;
    }
    return is_low;
}
