/* One pulse at a time on the limbs' gates. Software starts it; a timer ends it through PPI and GPIOTE, so that it
 * ends in time even where the core hangs. */
#ifndef PULSE_H
#define PULSE_H

#include <stdint.h>

#define FK_PULSE_OK 0
#define FK_PULSE_ERROR_RANGE (-1) /* no limb, a limb that the board lacks, 0 us or above FK_BOARD_PULSE_MAX_US */
#define FK_PULSE_ERROR_BUSY (-2)  /* a pulse is still on */

/* Gates low, pins handed to GPIOTE. Call first of all. */
void fk_pulse_init(void);

/* Heat the limbs of limb_mask (bit i = limb i) for pulse_us, 1 to FK_BOARD_PULSE_MAX_US.
 * @retval FK_PULSE_OK or one of the errors above, and then nothing has changed
 */
int32_t fk_pulse_start(uint8_t limb_mask, uint32_t pulse_us);

/* All gates low now. */
void fk_pulse_off(void);

/* 1 while a pulse is on. Takes back the timer's event once it has ended. */
int32_t fk_pulse_is_on(void);

#endif
