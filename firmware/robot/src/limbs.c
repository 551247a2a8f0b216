#include "limbs.h"

#include <errno.h>
#include <hal/nrf_clock.h>
#include <helpers/nrfx_gppi.h>
#include <nrfx_gpiote.h>
#include <nrfx_timer.h>
#include <zephyr/devicetree.h>
#include <zephyr/drivers/clock_control/nrf_clock_control.h>
#include <zephyr/irq.h>
#include <zephyr/kernel.h>
#include <zephyr/sys/atomic.h>
#include <zephyr/sys/notify.h>
#include <zephyr/sys/onoff.h>
#include <zephyr/sys/util.h>

/* nrfx 4 has other instances, returns an errno and connects PPI by handles. */
#if NRFX_CONFIG_API_VER_MAJOR != 3
#error "limbs.c is written for nrfx 3, which Zephyr has from 3.7 to 4.3"
#endif

#define LIMBS_NODE DT_NODELABEL(limbs)
#define LIMB_PIN(node, property, index) DT_GPIO_PIN_BY_IDX(node, property, index)

static const uint8_t pins[] = {DT_FOREACH_PROP_ELEM_SEP(LIMBS_NODE, gpios, LIMB_PIN, (, ))};
BUILD_ASSERT(ARRAY_SIZE(pins) <= 8, "the core knows at most eight limbs");

/* The gates go high at the timer's first tick, so the compare value of the end is one more than the length. */
#define BEGIN_TICK 1u
/* Resolution of the clock, and time from reading it until the gates switch. */
#define START_US 40u
/* A crystal takes 0.4 to 1.5 ms to start. It may report that it runs before it is stable (erratum 68), so it is
 * tested twice. */
#define CLOCK_TESTS 2u
#define CLOCK_TESTS_MAX 20u /* 1 ms apart */

static const nrfx_timer_t timer = NRFX_TIMER_INSTANCE(2);
static const nrfx_gpiote_t gpiote = NRFX_GPIOTE_INSTANCE(0);
static void (*on_end)(void);
static atomic_t is_on;
static uint32_t begin_channels[ARRAY_SIZE(pins)]; /* masks of PPI channels: the timer's begin -> SET of a limb */
static uint32_t all_begin_channels;
static uint8_t end_channel; /* the timer's end -> CLR of the last two limbs that were connected */
static uint8_t is_ready;
static struct onoff_client clock_client;
static uint8_t clock_is_held;

static void timer_event(nrf_timer_event_t event, void *context)
{
    (void)context;
    if (event == NRF_TIMER_EVENT_COMPARE0) {
        atomic_set(&is_on, 0);
        on_end();
    }
}

uint64_t fk_limbs_now_us(void)
{
    return k_ticks_to_us_floor64((uint64_t)k_uptime_ticks());
}

/* Set the pin low, connect its CLR task to the timer's end, and its SET task to the timer's begin by a channel
 * that is disabled. Two limbs share the channel of the end, one by its fork, since Bluetooth's controller leaves
 * twelve channels, and eight limbs need all of them. */
static int32_t connect_limb(uint32_t limb)
{
    const uint8_t pin = pins[limb];
    static const nrfx_gpiote_output_config_t output = {
        .drive = NRF_GPIO_PIN_S0S1,
        .input_connect = NRF_GPIO_PIN_INPUT_DISCONNECT,
        .pull = NRF_GPIO_PIN_NOPULL,
    };
    /* Only the SET and CLR tasks are used; a polarity of none would turn the tasks off. */
    nrfx_gpiote_task_config_t task = {
        .polarity = NRF_GPIOTE_POLARITY_TOGGLE,
        .init_val = NRF_GPIOTE_INITIAL_VALUE_LOW,
    };
    uint8_t begin;

    if (nrfx_gpiote_channel_alloc(&gpiote, &task.task_ch) != NRFX_SUCCESS ||
        nrfx_gpiote_output_configure(&gpiote, pin, &output, &task) != NRFX_SUCCESS ||
        nrfx_gppi_channel_alloc(&begin) != NRFX_SUCCESS) {
        return FK_LIMBS_ERROR_HARDWARE;
    }
    nrfx_gpiote_out_task_enable(&gpiote, pin);
    if (limb % 2u != 0u) {
        nrfx_gppi_fork_endpoint_setup(end_channel, nrfx_gpiote_clr_task_address_get(&gpiote, pin));
    } else if (nrfx_gppi_channel_alloc(&end_channel) == NRFX_SUCCESS) {
        nrfx_gppi_channel_endpoints_setup(end_channel,
                                          nrfx_timer_compare_event_address_get(&timer, NRF_TIMER_CC_CHANNEL0),
                                          nrfx_gpiote_clr_task_address_get(&gpiote, pin));
        nrfx_gppi_channels_enable((uint32_t)BIT(end_channel));
    } else {
        return FK_LIMBS_ERROR_HARDWARE;
    }
    nrfx_gppi_channel_endpoints_setup(begin, nrfx_timer_compare_event_address_get(&timer, NRF_TIMER_CC_CHANNEL1),
                                      nrfx_gpiote_set_task_address_get(&gpiote, pin));
    begin_channels[limb] = (uint32_t)BIT(begin);
    all_begin_channels |= (uint32_t)BIT(begin);
    return FK_LIMBS_OK;
}

int32_t fk_limbs_init(void (*ended)(void))
{
    nrfx_timer_config_t config = NRFX_TIMER_DEFAULT_CONFIG(1000000);

    on_end = ended;
    config.bit_width = NRF_TIMER_BIT_WIDTH_32;
    IRQ_CONNECT(DT_IRQN(DT_NODELABEL(timer2)), DT_IRQ(DT_NODELABEL(timer2), priority), nrfx_isr,
                nrfx_timer_2_irq_handler, 0);
    if (nrfx_timer_init(&timer, &config, timer_event) != NRFX_SUCCESS ||
        (!nrfx_gpiote_init_check(&gpiote) && nrfx_gpiote_init(&gpiote, 0) != NRFX_SUCCESS)) {
        return FK_LIMBS_ERROR_HARDWARE;
    }
    for (uint32_t limb = 0; limb < ARRAY_SIZE(pins); ++limb) {
        if (connect_limb(limb) != FK_LIMBS_OK) {
            return FK_LIMBS_ERROR_HARDWARE;
        }
    }
    is_ready = 1;
    return FK_LIMBS_OK;
}

int32_t fk_limbs_clock_is_exact(void)
{
    nrf_clock_hfclk_t source = NRF_CLOCK_HFCLK_LOW_ACCURACY;

    return clock_is_held != 0 && nrf_clock_is_running(NRF_CLOCK, NRF_CLOCK_DOMAIN_HFCLK, &source) &&
           source == NRF_CLOCK_HFCLK_HIGH_ACCURACY;
}

int32_t fk_limbs_hold_clock(void)
{
    int result = -EAGAIN;
    uint32_t good = 0;

    if (clock_is_held != 0) {
        return fk_limbs_clock_is_exact() ? FK_LIMBS_OK : FK_LIMBS_ERROR_CLOCK;
    }
    sys_notify_init_spinwait(&clock_client.notify);
    if (onoff_request(z_nrf_clock_control_get_onoff(CLOCK_CONTROL_NRF_SUBSYS_HF), &clock_client) < 0) {
        return FK_LIMBS_ERROR_CLOCK;
    }
    clock_is_held = 1;
    for (uint32_t tests = 0; tests < CLOCK_TESTS_MAX; ++tests) {
        if (sys_notify_fetch_result(&clock_client.notify, &result) == 0 && result >= 0 && fk_limbs_clock_is_exact()) {
            ++good;
        }
        if (good == CLOCK_TESTS) {
            return FK_LIMBS_OK;
        }
        (void)k_sleep(K_MSEC(1));
    }
    fk_limbs_release_clock();
    return FK_LIMBS_ERROR_CLOCK;
}

void fk_limbs_release_clock(void)
{
    if (clock_is_held != 0) {
        (void)onoff_cancel_or_release(z_nrf_clock_control_get_onoff(CLOCK_CONTROL_NRF_SUBSYS_HF), &clock_client);
        clock_is_held = 0;
    }
}

/* Prepare the timer's two events for these gates; the timer is stopped at 0. nrfx requires that a timer be
 * disabled before it is enabled again, even if it has stopped by itself. */
static void set_up(uint8_t limb_mask, uint32_t pulse_us)
{
    nrfx_timer_disable(&timer);
    nrfx_timer_clear(&timer);
    nrfx_timer_compare(&timer, NRF_TIMER_CC_CHANNEL1, BEGIN_TICK, false);
    nrfx_timer_extended_compare(&timer, NRF_TIMER_CC_CHANNEL0, BEGIN_TICK + pulse_us,
                                NRF_TIMER_SHORT_COMPARE0_STOP_MASK | NRF_TIMER_SHORT_COMPARE0_CLEAR_MASK, true);
    nrfx_gppi_channels_disable(all_begin_channels);
    for (uint32_t limb = 0; limb < ARRAY_SIZE(pins); ++limb) {
        if ((limb_mask & BIT(limb)) != 0) {
            nrfx_gppi_channels_enable(begin_channels[limb]);
        }
    }
}

int32_t fk_limbs_pulse(uint8_t limb_mask, uint32_t pulse_us, uint64_t latest_us)
{
    if (is_ready == 0) {
        return FK_LIMBS_ERROR_HARDWARE;
    }
    if (limb_mask == 0 || (uint32_t)limb_mask >> ARRAY_SIZE(pins) != 0 || pulse_us == 0 ||
        pulse_us > FK_LIMBS_PULSE_MAX_US) {
        return FK_LIMBS_ERROR_RANGE;
    }
    if (!fk_limbs_clock_is_exact()) {
        return FK_LIMBS_ERROR_CLOCK;
    }
    if (!atomic_cas(&is_on, 0, 1)) {
        return FK_LIMBS_ERROR_BUSY;
    }
    set_up(limb_mask, pulse_us);
    /* No interrupt between reading the clock and the one write that starts the timer, nor before it is read again: one
     * that takes long would look like a pulse that began late. */
    const unsigned int key = irq_lock();
    const int32_t in_time = fk_limbs_now_us() + START_US <= latest_us;
    if (in_time != 0) {
        nrfx_timer_enable(&timer);
    }
    const int32_t was_held_up = fk_limbs_now_us() > latest_us + START_US;
    irq_unlock(key);
    if (in_time == 0) {
        atomic_set(&is_on, 0);
        return FK_LIMBS_ERROR_LATE;
    }
    return was_held_up ? FK_LIMBS_ERROR_HELD_UP : FK_LIMBS_OK;
}

void fk_limbs_off(void)
{
    if (is_ready == 0) {
        return;
    }
    /* In this order: no pulse can begin any more, all gates go low, and only then does the timer stop that would
     * end a pulse. */
    nrfx_gppi_channels_disable(all_begin_channels);
    for (uint32_t limb = 0; limb < ARRAY_SIZE(pins); ++limb) {
        nrfx_gpiote_clr_task_trigger(&gpiote, pins[limb]);
    }
    nrfx_timer_disable(&timer);
    atomic_set(&is_on, 0);
}
