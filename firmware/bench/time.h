#ifndef TIME_H
#define TIME_H

#include <stdint.h>

/* TIMER0 at 1 MHz. Its third compare register starts the pulses. */
#define FK_TIME_TIMER TIMER0_BASE
#define FK_TIME_CC_PULSE 2u

void fk_time_init(void);

/* Microseconds since fk_time_init(). It must be called at least once in 71 minutes, or a wrap of 2^32 us goes
 * unnoticed; the loop calls it in every turn, and fk_time_wake_at() limits how long it sleeps. */
uint64_t fk_time_now_us(void);

/* Let TIMER0 raise its event at wake_us, or after 2^31 us if that is sooner.
 * @retval 1  the event will come: it is safe to sleep
 * @retval 0  that time has passed already: do not sleep
 */
int32_t fk_time_wake_at(uint64_t wake_us);

/* Clear a wake event that has happened. */
void fk_time_clear_wake(void);

#endif
