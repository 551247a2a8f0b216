/* One pulse at a time on the limbs' gates. It begins and ends by compare events of a timer, which reach the gates
 * through PPI and GPIOTE: once that timer is started, the pulse is right whatever the processor does or omits. */
#ifndef LIMBS_H
#define LIMBS_H

#include <stdint.h>

#define FK_LIMBS_PULSE_MAX_US 100000u /* whatever is asked for: an SMA limb burns if it is heated for longer */

#define FK_LIMBS_OK 0
#define FK_LIMBS_ERROR_RANGE (-1) /* no limb, a limb that the board lacks, or a length of 0 or above the maximum */
#define FK_LIMBS_ERROR_BUSY (-2)  /* a pulse is still on */
#define FK_LIMBS_ERROR_HARDWARE (-3)
#define FK_LIMBS_ERROR_HELD_UP (-4) /* it began too late: the processor was halted between two instructions, as by a debugger */
#define FK_LIMBS_ERROR_CLOCK (-5)   /* the crystal does not run, so the pulse would not have its length */
#define FK_LIMBS_ERROR_LATE (-16)   /* it could not begin by the latest time, and did not: the core's FK_PULSE_LATE */

/* The robot's clock. */
uint64_t fk_limbs_now_us(void);

/* All gates low, timer and channels allocated. `ended` is called from an interrupt at each pulse's end.
 * @retval FK_LIMBS_OK
 * @retval FK_LIMBS_ERROR_HARDWARE  no pulse will ever start
 */
int32_t fk_limbs_init(void (*ended)(void));

/* Request the 32 MHz crystal, which Zephyr otherwise runs for the radio alone: with the chip's RC oscillator a pulse
 * may last 8 % longer. Waits until it runs, for 20 ms at most. A further call while it is held does nothing.
 * @retval FK_LIMBS_OK
 * @retval FK_LIMBS_ERROR_CLOCK  it does not run, and is not held
 */
int32_t fk_limbs_hold_clock(void);

/* Release the crystal, without which no pulse begins. Does nothing where it is not held. */
void fk_limbs_release_clock(void);

/* @retval 1 the crystal is held and runs */
int32_t fk_limbs_clock_is_exact(void);

/* Heat the limbs of limb_mask (bit i = limb i) for pulse_us, 1 to FK_LIMBS_PULSE_MAX_US. The pulse begins now, and by
 * latest_us or not at all.
 * @retval FK_LIMBS_OK             it has begun
 * @retval FK_LIMBS_ERROR_HELD_UP  it has begun, but too late
 * @retval another negative number: no gate was high
 */
int32_t fk_limbs_pulse(uint8_t limb_mask, uint32_t pulse_us, uint64_t latest_us);

/* All gates low now. */
void fk_limbs_off(void);

#endif
