/* Sleep until something happens, without interrupts being taken: SEVONPEND lets an interrupt that only becomes
 * pending wake WFE (ARMv7-M ARM, B1.5.18). */
#ifndef SLEEP_H
#define SLEEP_H

void fk_sleep_init(void);

/* Clear pending interrupts. Call it after the peripherals' events were cleared and before their state is looked at:
 * an event after this wakes fk_sleep(), even if it comes before fk_sleep() is called. */
void fk_sleep_clear_pending(void);

/* Sleep until an event of UARTE0, TIMER0, TIMER2 or POWER whose interrupt is enabled there. May return for no reason. */
void fk_sleep(void);

#endif
