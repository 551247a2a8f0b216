#ifndef CLOCK_H
#define CLOCK_H

#include <stdint.h>

/* Switch the flash's instruction cache on, and the 32 MHz crystal, for good: without it UART's bit times and
 * pulses drift by up to 8 %. Returns when it runs, after about 0.4 ms, or after some milliseconds without it. */
void fk_clock_init(void);

/* @retval 1 time comes from the crystal, 0 from the chip's own oscillator: no pulse may begin */
int32_t fk_clock_is_exact(void);

#endif
