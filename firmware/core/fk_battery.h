/* Whether a battery of the limbs is too low to heat one: by its voltage at rest, behind a divider on a pin.
 *
 * A battery sags while a limb is heated, so what is read then, or soon after, does not count. FK_BATTERY_AGREE readings in
 * a row decide. Until they have come the batteries are unknown, which counts as low; so does a reading that never
 * comes. The port reads the pins: FK_BATTERY_INPUTS and FK_BATTERY_LEAST_MV of fk_robot_config.h say which, and the limit.
 */
#ifndef FK_BATTERY_H
#define FK_BATTERY_H

#include <stdint.h>

#define FK_BATTERY_EVERY_US 100000u
#define FK_BATTERY_LATE_US 50000u  /* a reading that takes longer has failed */
#define FK_BATTERY_REST_US 300000u /* since a pulse began, so 200 ms after the longest one */
#define FK_BATTERY_AGREE 3u
#define FK_BATTERY_WELL_SHARE 50u /* well again is so much above the limit: a fiftieth */

typedef struct {
    uint64_t begun_us;  /* of the last reading */
    uint64_t heated_us; /* a limb was last seen on */
    uint8_t is_reading;
    uint8_t agree; /* readings in a row that speak against is_low */
    uint8_t is_low;
} fk_battery_t;

/* Unknown, so low. */
void fk_battery_init(fk_battery_t *battery);

/* For every turn of the loop, and after a pulse was started.
 * @retval 1  begin a reading now; what it reads goes to fk_battery_note
 */
int32_t fk_battery_is_due(fk_battery_t *battery, uint64_t now_us, int32_t limb_is_on, int32_t least_mv);

/* The reading that was begun has come.
 * @param lowest_mv  at the pins, of the battery that has least
 */
void fk_battery_note(fk_battery_t *battery, int32_t lowest_mv, int32_t least_mv);

int32_t fk_battery_is_low(const fk_battery_t *battery);

#endif
