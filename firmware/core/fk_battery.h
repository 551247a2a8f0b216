/* Whether a battery that heats limbs is too low, by its voltage without load, behind a divider on a pin.
 *
 * A battery's voltage sags while a limb is heated, so a reading during a pulse or soon after it does not count.
 * FK_BATTERY_AGREE readings in a row decide. Until there are that many the battery counts as low, and a reading that
 * never arrives counts as 0 mV. The port reads the pins of FK_BATTERY_INPUTS, and FK_BATTERY_LEAST_MV is the limit
 * (fk_robot_config.h).
 */
#ifndef FK_BATTERY_H
#define FK_BATTERY_H

#include <stdint.h>

#define FK_BATTERY_EVERY_US 100000u
#define FK_BATTERY_LATE_US 50000u  /* a reading that takes longer has failed */
#define FK_BATTERY_REST_US 300000u /* since a limb was last seen on: at least 200 ms after its pulse */
#define FK_BATTERY_AGREE 3u
#define FK_BATTERY_HYSTERESIS_SHARE 50u /* a low battery is sufficient from a fiftieth above the limit on */

typedef struct {
    uint64_t begun_us;  /* when the last reading was begun */
    uint64_t heated_us; /* when a limb was last seen on */
    uint8_t is_reading;
    uint8_t agree; /* readings in a row that contradict is_low */
    uint8_t is_low;
} fk_battery_t;

/* Nothing was read yet, so it counts as low. */
void fk_battery_init(fk_battery_t *battery);

/* Call it in every turn of the loop, and after a pulse was started.
 * @retval 1  begin a reading now; its result goes to fk_battery_note()
 */
int32_t fk_battery_is_due(fk_battery_t *battery, uint64_t now_us, int32_t limb_is_on, int32_t least_mv);

/* The result of the reading that was begun.
 * @param lowest_mv  at the pin of the lowest battery
 */
void fk_battery_note(fk_battery_t *battery, int32_t lowest_mv, int32_t least_mv);

int32_t fk_battery_is_low(const fk_battery_t *battery);

#endif
