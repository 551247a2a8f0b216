/* The limbs' batteries, by the SAADC: the inputs and the limit are the robot's (its TOML's [battery]). */
#ifndef BATTERY_H
#define BATTERY_H

#include <stdint.h>

void fk_battery_pins_init(void);

/* For every turn of the loop, after it started a pulse. */
void fk_battery_pins_service(int32_t limb_is_on);

/* Whether a battery is too low to heat a limb, or unknown. Never where no input sees one. */
int32_t fk_battery_pins_are_low(void);

#endif
