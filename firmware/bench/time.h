#ifndef TIME_H
#define TIME_H

#include <stdint.h>

/* TIMER0 at 1 MHz. Its third compare register is for the pulses, which begin by it. */
#define FK_TIME_TIMER TIMER0_BASE
#define FK_TIME_CC_PULSE 2u

void fk_time_init(void);

/* Microseconds since fk_time_init. Must be called at least once in 71 minutes, or a wrap of 2^32 us goes unseen;
 * fk_time_wake_at sees to that. */
uint64_t fk_time_now_us(void);

/* Let TIMER0 raise its event at wake_us, or after 2^31 us if that is sooner.
 * @retval 1  set: it is safe to sleep
 * @retval 0  that time is already here: do not sleep
 */
int32_t fk_time_wake_at(uint64_t wake_us);

/* Take back a wake event that has happened. */
void fk_time_clear_wake(void);

#endif
