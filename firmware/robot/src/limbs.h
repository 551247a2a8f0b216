/* One pulse at a time on the limbs' gates. Software starts it; a timer ends it through PPI and GPIOTE, so that it
 * ends in time even where the core hangs. */
#ifndef LIMBS_H
#define LIMBS_H

#include <stdint.h>

#define FK_LIMBS_PULSE_MAX_US 100000u /* whatever it is asked for: an SMA limb burns when it is heated on */

#define FK_LIMBS_OK 0
#define FK_LIMBS_ERROR_RANGE (-1) /* no limb, a limb that the board lacks, 0 us or above the maximum */
#define FK_LIMBS_ERROR_BUSY (-2)  /* a pulse is still on */
#define FK_LIMBS_ERROR_HARDWARE (-3)

/* Gates low, timer and channels taken. `ended` is called from an interrupt at each pulse's end.
 * @retval FK_LIMBS_OK, FK_LIMBS_ERROR_HARDWARE: then no pulse will ever start
 */
int32_t fk_limbs_init(void (*ended)(void));

/* Heat the limbs of limb_mask (bit i = limb i) for pulse_us, 1 to FK_LIMBS_PULSE_MAX_US.
 * @retval FK_LIMBS_OK or an error, and then nothing has changed
 */
int32_t fk_limbs_pulse(uint8_t limb_mask, uint32_t pulse_us);

/* All gates low now. */
void fk_limbs_off(void);

#endif
