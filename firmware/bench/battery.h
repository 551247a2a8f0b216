/* The limbs' batteries, by the SAADC: the inputs and the limit are the robot's (its TOML's [battery]). */
#ifndef BATTERY_H
#define BATTERY_H

#include <stdint.h>

void fk_battery_pins_init(void);

/* Call it in every turn of the loop, after a pulse may have been started. limb_is_on: 1 while or when a limb is heated. */
void fk_battery_pins_service(int32_t limb_is_on);

/* 1 where a battery is too low to heat a limb, or not known yet; 0 where no input sees a battery. */
int32_t fk_battery_pins_are_low(void);

#endif
