/* One pulse at a time on the limbs' gates. Both its ends are compare events of a timer, which reach the gates through
 * PPI and GPIOTE: once that timer is started it does not matter what the core does or leaves undone. */
#ifndef LIMBS_H
#define LIMBS_H

#include <stdint.h>

#define FK_LIMBS_PULSE_MAX_US 100000u /* whatever it is asked for: an SMA limb burns when it is heated on */

#define FK_LIMBS_OK 0
#define FK_LIMBS_ERROR_RANGE (-1) /* no limb, a limb that the board lacks, 0 us or above the maximum */
#define FK_LIMBS_ERROR_BUSY (-2)  /* a pulse is still on */
#define FK_LIMBS_ERROR_HARDWARE (-3)
#define FK_LIMBS_ERROR_HELD_UP (-4) /* it began, and later than asked: between two instructions, as by a debugger */
#define FK_LIMBS_ERROR_CLOCK (-5)   /* the crystal does not run: the pulse's time would be another */
#define FK_LIMBS_ERROR_LATE (-16)   /* it could not begin by the latest time, and did not: the core's FK_PULSE_LATE */

/* The robot's clock. */
uint64_t fk_limbs_now_us(void);

/* Gates low, timer and channels taken. `ended` is called from an interrupt at each pulse's end.
 * @retval FK_LIMBS_OK, FK_LIMBS_ERROR_HARDWARE: then no pulse will ever start
 */
int32_t fk_limbs_init(void (*ended)(void));

/* Ask for the 32 MHz crystal, which Zephyr else runs for the radio alone: by the chip's own oscillator a pulse may last 8 %
 * longer. Waits until it runs, 20 ms at the most. Once more while it is held does nothing.
 * @retval FK_LIMBS_OK, FK_LIMBS_ERROR_CLOCK: it does not run, and is not held
 */
int32_t fk_limbs_hold_clock(void);

/* Give the crystal back; no pulse begins any more. Nothing where it is not held. */
void fk_limbs_release_clock(void);

/* @retval 1 the crystal is held and runs */
int32_t fk_limbs_clock_is_exact(void);

/* Heat the limbs of limb_mask (bit i = limb i) for pulse_us, 1 to FK_LIMBS_PULSE_MAX_US, from now on and from latest_us at
 * the latest.
 * @retval FK_LIMBS_OK or an error, and then no gate was high but for FK_LIMBS_ERROR_HELD_UP
 */
int32_t fk_limbs_pulse(uint8_t limb_mask, uint32_t pulse_us, uint64_t latest_us);

/* All gates low now. */
void fk_limbs_off(void);

#endif
