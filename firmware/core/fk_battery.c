#include "fk_battery.h"

void fk_battery_init(fk_battery_t *battery)
{
    battery->begun_us = 0u;
    battery->heated_us = 0u;
    battery->is_reading = 0u;
    battery->agree = 0u;
    battery->is_low = 1u;
}

static void count(fk_battery_t *battery, int32_t lowest_mv, int32_t least_mv)
{
    int32_t limit_mv = (battery->is_low != 0u) ? least_mv + least_mv / (int32_t)FK_BATTERY_HYSTERESIS_SHARE : least_mv;
    uint8_t reads_low = (lowest_mv < limit_mv) ? 1u : 0u;
    battery->agree = (reads_low == battery->is_low) ? 0u : (uint8_t)(battery->agree + 1u);
    if (battery->agree >= FK_BATTERY_AGREE) {
        battery->is_low = reads_low;
        battery->agree = 0u;
    }
}

int32_t fk_battery_is_due(fk_battery_t *battery, uint64_t now_us, int32_t limb_is_on, int32_t least_mv)
{
    if (limb_is_on != 0) {
        battery->heated_us = now_us;
    }
    if (battery->is_reading != 0u && now_us - battery->begun_us > FK_BATTERY_LATE_US) {
        battery->is_reading = 0u;
        count(battery, 0, least_mv);
    }
    if (battery->is_reading != 0u || now_us - battery->heated_us < FK_BATTERY_REST_US ||
        now_us - battery->begun_us < FK_BATTERY_EVERY_US) {
        return 0;
    }
    battery->begun_us = now_us;
    battery->is_reading = 1u;
    return 1;
}

void fk_battery_note(fk_battery_t *battery, int32_t lowest_mv, int32_t least_mv)
{
    battery->is_reading = 0u;
    if (battery->heated_us <= battery->begun_us) {
        count(battery, lowest_mv, least_mv);
    }
}

int32_t fk_battery_is_low(const fk_battery_t *battery) { return battery->is_low; }
