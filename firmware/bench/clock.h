#ifndef CLOCK_H
#define CLOCK_H

/* Start the 32 MHz crystal, without which a UART's bit times and the pulses drift by up to 5 %, and the flash's
 * instruction cache. Returns when the crystal runs (about 0.4 ms); without a crystal it never does, limbs off. */
void fk_clock_init(void);

#endif
