#include "battery.h"

#include <hal/nrf_saadc.h>
#include <zephyr/devicetree.h>
#include <zephyr/sys/util.h>

#include "fk_battery.h"
#include "fk_robot_config.h"
#include "limbs.h"

#define INPUTS 8u
#define IS_READ(input) (((FK_BATTERY_INPUTS) >> (input)) & 1u)

/* AIN0 to AIN3 are P0.02 to P0.05, AIN4 to AIN7 P0.28 to P0.31. */
#define PIN_MASK ((((FK_BATTERY_INPUTS) & 0xFu) << 2) | ((((FK_BATTERY_INPUTS) >> 4) & 0xFu) << 28))
#define GATE_BIT(node, property, index) (1u << DT_GPIO_PIN_BY_IDX(node, property, index))
#define GATES_MASK (DT_FOREACH_PROP_ELEM_SEP(DT_NODELABEL(limbs), gpios, GATE_BIT, (|)))
BUILD_ASSERT((PIN_MASK & GATES_MASK) == 0u, "a battery's input is a limb's gate: change battery.inputs of the robot");

/* 12 bits of 3.6 V: gain 1/6, reference 0.6 V. */
#define FULL_MV 3600
#define FULL_BITS 12

static fk_battery_t battery;
/* The converter writes them: halfwords on this chip, for which nrfx has no type of its own from 3.2 on. */
static volatile int16_t results[INPUTS];

void fk_battery_pins_init(void)
{
    static const nrf_saadc_channel_config_t channel = {
        .resistor_p = NRF_SAADC_RESISTOR_DISABLED,
        .resistor_n = NRF_SAADC_RESISTOR_DISABLED,
        .gain = NRF_SAADC_GAIN1_6,
        .reference = NRF_SAADC_REFERENCE_INTERNAL,
        .acq_time = NRF_SAADC_ACQTIME_40US, /* for dividers of high resistance */
        .mode = NRF_SAADC_MODE_SINGLE_ENDED,
        .burst = NRF_SAADC_BURST_DISABLED,
    };
    uint8_t count = 0u;

    if (FK_BATTERY_INPUTS == 0u) {
        return;
    }
    fk_battery_init(&battery);
    for (uint32_t input = 0u; input < INPUTS; ++input) {
        if (IS_READ(input) != 0u) {
            nrf_saadc_channel_init(NRF_SAADC, count, &channel);
            nrf_saadc_channel_input_set(NRF_SAADC, count, (nrf_saadc_input_t)(NRF_SAADC_INPUT_AIN0 + input),
                                        NRF_SAADC_INPUT_DISABLED);
            ++count;
        }
    }
    nrf_saadc_resolution_set(NRF_SAADC, NRF_SAADC_RESOLUTION_12BIT);
    nrf_saadc_buffer_init(NRF_SAADC, (void *)results, count);
    nrf_saadc_enable(NRF_SAADC);
    nrf_saadc_task_trigger(NRF_SAADC, NRF_SAADC_TASK_START);
}

static int32_t lowest_mv(void)
{
    int32_t lowest = FULL_MV;
    uint32_t count = 0u;

    for (uint32_t input = 0u; input < INPUTS; ++input) {
        if (IS_READ(input) != 0u) {
            lowest = MIN(lowest, (results[count] * FULL_MV) >> FULL_BITS);
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
    if (nrf_saadc_event_check(NRF_SAADC, NRF_SAADC_EVENT_END)) {
        nrf_saadc_event_clear(NRF_SAADC, NRF_SAADC_EVENT_END);
        fk_battery_note(&battery, lowest_mv(), FK_BATTERY_LEAST_MV);
        nrf_saadc_task_trigger(NRF_SAADC, NRF_SAADC_TASK_START); /* a buffer for the next readings */
    }
    if (fk_battery_is_due(&battery, fk_limbs_now_us(), limb_is_on, FK_BATTERY_LEAST_MV) != 0) {
        nrf_saadc_task_trigger(NRF_SAADC, NRF_SAADC_TASK_SAMPLE);
    }
}

int32_t fk_battery_pins_are_low(void) { return (FK_BATTERY_INPUTS != 0u) ? fk_battery_is_low(&battery) : 0; }
