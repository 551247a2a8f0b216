#ifndef WATCHDOG_H
#define WATCHDOG_H

#include <stdint.h>

#define FK_WATCHDOG_MAX_US 1000000u      /* from the last feeding to the reset, at the slowest clock that is allowed */
#define FK_WATCHDOG_FEED_MAX_US 500000u  /* the loop must come round within this */

/* Read why the chip started, FK_RESET_..., and take that back. Once after each start. */
uint8_t fk_watchdog_reset_reason(void);

/* Start the watchdog; nothing but a reset stops it. It runs on while the core sleeps, and stands still while a debugger
 * holds it. */
void fk_watchdog_init(void);

/* The loop has come round. */
void fk_watchdog_feed(void);

#endif
