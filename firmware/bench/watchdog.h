#ifndef WATCHDOG_H
#define WATCHDOG_H

#include <stdint.h>

#define FK_WATCHDOG_MAX_US 1000000u      /* from the last feed to the reset, with the slowest clock that is allowed */
#define FK_WATCHDOG_FEED_MAX_US 500000u  /* longest time between two feeds by the loop */

/* Read why the chip started, FK_RESET_..., and clear it. Call it once after each start. */
uint8_t fk_watchdog_reset_reason(void);

/* Start the watchdog, which only a reset stops. It runs while the processor sleeps, and pauses while a debugger
 * halts it. */
void fk_watchdog_init(void);

/* Feed the watchdog, once in each turn of the loop. */
void fk_watchdog_feed(void);

#endif
