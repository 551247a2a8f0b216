/* One pulse at a time on the limbs' gates. It begins and ends by compare events of timers, which reach the gates
 * through PPI and GPIOTE: once the processor has enabled the start by one last write, the pulse is right whatever
 * the processor does or omits. */
#ifndef PULSE_H
#define PULSE_H

#include <stdint.h>

#define FK_PULSE_OK 0
#define FK_PULSE_ERROR_RANGE (-1) /* no limb, a limb that the board lacks, or a length of 0 or above FK_BOARD_PULSE_MAX_US */
#define FK_PULSE_ERROR_BUSY (-2)  /* a pulse is still on */
#define FK_PULSE_ERROR_CLOCK (-3) /* the crystal does not run, so the pulse would not have its length */
#define FK_PULSE_ERROR_LATE (-16) /* it could not begin by the latest time, and did not: the core's FK_PULSE_LATE */

/* All gates low, pins controlled by GPIOTE. Call it first of all. */
void fk_pulse_init(void);

/* Heat the limbs of limb_mask (bit i = limb i) for pulse_us, 1 to FK_BOARD_PULSE_MAX_US. The pulse begins now, and by
 * latest_us on the clock of time.h, or not at all.
 * @retval FK_PULSE_OK  it has begun
 * @retval negative     one of the errors above: no gate was high
 */
int32_t fk_pulse_start(uint8_t limb_mask, uint32_t pulse_us, uint64_t latest_us);

/* All gates low now. */
void fk_pulse_off(void);

/* 1 while a pulse is on. Clears the timer's event once it has ended. */
int32_t fk_pulse_is_on(void);

#endif
