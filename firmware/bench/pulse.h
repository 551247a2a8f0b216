/* One pulse at a time on the limbs' gates. Both its ends are compare events of timers, which reach the gates through PPI
 * and GPIOTE: once the core has allowed a pulse by its last write, it does not matter what the core does or leaves undone. */
#ifndef PULSE_H
#define PULSE_H

#include <stdint.h>

#define FK_PULSE_OK 0
#define FK_PULSE_ERROR_RANGE (-1) /* no limb, a limb that the board lacks, 0 us or above FK_BOARD_PULSE_MAX_US */
#define FK_PULSE_ERROR_BUSY (-2)  /* a pulse is still on */
#define FK_PULSE_ERROR_CLOCK (-3) /* the crystal does not run: its time would be another */
#define FK_PULSE_ERROR_LATE (-16) /* it could not begin by the latest time, and did not: the core's FK_PULSE_LATE */

/* Gates low, pins handed to GPIOTE. Call first of all. */
void fk_pulse_init(void);

/* Heat the limbs of limb_mask (bit i = limb i) for pulse_us, 1 to FK_BOARD_PULSE_MAX_US, from now on and from latest_us
 * at the latest, by the clock of time.h.
 * @retval FK_PULSE_OK or one of the errors above, and then no gate was high
 */
int32_t fk_pulse_start(uint8_t limb_mask, uint32_t pulse_us, uint64_t latest_us);

/* All gates low now. */
void fk_pulse_off(void);

/* 1 while a pulse is on. Takes back the timer's event once it has ended. */
int32_t fk_pulse_is_on(void);

#endif
