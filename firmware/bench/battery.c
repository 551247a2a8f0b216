#include "battery.h"

#include "board.h"
#include "fk_battery.h"
#include "fk_robot_config.h"
#include "nrf52832_regs.h"
#include "time.h"

#define INPUTS 8u
#define IS_READ(input) (((FK_BATTERY_INPUTS) >> (input)) & 1u)

/* AIN4 to AIN7 are P0.28 to P0.31, the gates of limbs 5 to 8. */
typedef char fk_battery_input_is_no_gate[((((FK_BATTERY_INPUTS) >> 4) & ((1u << FK_BOARD_LIMBS) - 1u) >> 4) == 0u) ? 1 : -1];

/* 12 bits of 3.6 V: gain 1/6, reference 0.6 V. */
#define FULL_MV 3600
#define FULL_BITS 12

static fk_battery_t battery;
static volatile int16_t results[INPUTS];

void fk_battery_pins_init(void)
{
    uint32_t count = 0u;
    if (FK_BATTERY_INPUTS == 0u) {
        return;
    }
    fk_battery_init(&battery);
    for (uint32_t input = 0u; input < INPUTS; ++input) {
        if (IS_READ(input) != 0u) {
            SAADC_CH_CONFIG(count) = SAADC_CH_CONFIG_TACQ_40us << SAADC_CH_CONFIG_TACQ_Pos; /* for dividers of high resistance */
            SAADC_CH_PSELP(count) = input + SAADC_CH_PSELP_PSELP_AnalogInput0;
            ++count;
        }
    }
    SAADC_RESOLUTION = SAADC_RESOLUTION_VAL_12bit;
    SAADC_RESULT_PTR = (uint32_t)(uintptr_t)results;
    SAADC_RESULT_MAXCNT = count;
    SAADC_ENABLE = 1u;
    SAADC_TASKS_START = 1u;
}

static int32_t lowest_mv(void)
{
    int32_t lowest = FULL_MV;
    uint32_t count = 0u;
    for (uint32_t input = 0u; input < INPUTS; ++input) {
        if (IS_READ(input) != 0u) {
            int32_t here_mv = (results[count] * FULL_MV) >> FULL_BITS;
            lowest = (here_mv < lowest) ? here_mv : lowest;
            ++count;
        }
    }
    return lowest;
}

void fk_battery_pins_service(int32_t limb_is_on)
{
    if (FK_BATTERY_INPUTS == 0u) {
        return;
    }
    if (SAADC_EVENTS_END != 0u) {
        SAADC_EVENTS_END = 0u;
        fk_battery_note(&battery, lowest_mv(), FK_BATTERY_LEAST_MV);
        SAADC_TASKS_START = 1u; /* a buffer for the next readings; it is ready long before they are begun */
    }
    if (fk_battery_is_due(&battery, fk_time_now_us(), limb_is_on, FK_BATTERY_LEAST_MV) != 0) {
        SAADC_TASKS_SAMPLE = 1u;
    }
}

int32_t fk_battery_pins_are_low(void) { return (FK_BATTERY_INPUTS != 0u) ? fk_battery_is_low(&battery) : 0; }
