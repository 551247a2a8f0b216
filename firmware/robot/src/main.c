/* The robot on Zephyr: moves bytes, pins and time between the hardware and the core, nothing else. */
#include <zephyr/device.h>
#include <zephyr/devicetree.h>
#include <zephyr/drivers/hwinfo.h>
#include <zephyr/drivers/watchdog.h>
#include <zephyr/kernel.h>
#include <zephyr/sys/printk.h>

#include "battery.h"
#include "fk_robot_state.h"
#include "fk_table.h"
#include "flash.h"
#include "limbs.h"
#include "radio.h"
#include "supply.h"

#define WATCHDOG_MS 1000u
#define LONGEST_SLEEP_US 400000u /* the watchdog is fed by this loop alone: where it hangs, the robot resets */

static fk_robot_t robot;
static fk_frame_collector_t collector;
static fk_flash_t flash;
static fk_store_t store;
static __noinit fk_guard_persistent_t persistent;
static __noinit fk_wear_persistent_t learned;
static __noinit fk_log_t history;
static K_SEM_DEFINE(wake, 0, 1);

static void wake_up(void)
{
    k_sem_give(&wake);
}

static int start_watchdog(const struct device *watchdog)
{
    const struct wdt_timeout_cfg timeout = {
        .window = {.min = 0u, .max = WATCHDOG_MS},
        .flags = WDT_FLAG_RESET_SOC,
    };
    const int channel = wdt_install_timeout(watchdog, &timeout);

    if (channel < 0) {
        return channel;
    }
    const int error = wdt_setup(watchdog, WDT_OPT_PAUSE_HALTED_BY_DBG);
    return (error != 0) ? error : channel;
}

/* Before the core gets an ARM, with a code or without, the crystal is started; where it does not run, the core is
 * notified. A frame's type is its second byte, since COBS replaces zeros alone, and no type is zero. */
static void start_crystal_for_arm(const uint8_t *frame, uint32_t length)
{
    if (length < 2u || (frame[1] & ~FK_AUTH_BIT) != FK_FRAME_ARM) {
        return;
    }
    if (fk_limbs_hold_clock() != FK_LIMBS_OK) {
        printk("the 32 MHz crystal does not run: not armed\n");
        fk_robot_note_clock_failed(&robot);
    }
}

/* The crystal runs as long as a pulse may begin. Afterwards it runs for the radio alone. */
static void check_crystal(void)
{
    if (fk_robot_may(&robot, FK_EVENT_PULSE) != FK_STATUS_OK) {
        fk_limbs_release_clock();
    } else if (fk_limbs_clock_is_exact() == 0) {
        fk_robot_note_clock_failed(&robot);
    }
}

/* Takes one frame at most, so that between two feeds of the watchdog lie one command and one tick, however many
 * commands wait. Returns 1 where it took one, since another may wait. */
static int32_t take_frame(void)
{
    uint8_t byte;

    while (fk_radio_read(&byte) != 0) {
        const uint32_t length = fk_frame_collect(&collector, byte);
        if (length > 0u) {
            start_crystal_for_arm(collector.bytes, length);
            fk_robot_on_frame(&robot, collector.bytes, length, fk_limbs_now_us());
            check_crystal();
            return 1;
        }
    }
    return 0;
}

BUILD_ASSERT(FK_LIMBS_ERROR_LATE == FK_PULSE_LATE, "a pulse that is too late is a refused stroke, not an error");

/* Do what a tick's outputs say. For the guard the pulse begins at tick_us. A pulse that would begin more than
 * FK_PORT_LATE_US later does not begin, and the core refuses its stroke. Any other error is an internal error of
 * the robot. Returns 1 where the core needs a tick at once. */
static int32_t drive_limbs(const fk_outputs_t *outputs, uint64_t tick_us)
{
    if (outputs->all_off != 0u) {
        fk_limbs_off();
    }
    if (outputs->limb_mask == 0u) {
        return 0;
    }
    const int32_t error = fk_limbs_pulse(outputs->limb_mask, outputs->pulse_us, tick_us + FK_PORT_LATE_US);
    if (error != FK_LIMBS_OK) {
        fk_robot_note_pulse_failed(&robot, error);
    }
    return error != FK_LIMBS_OK;
}

static uint8_t reset_reason(void)
{
    uint32_t cause = 0u;

    if (hwinfo_get_reset_cause(&cause) != 0) {
        return FK_RESET_UNKNOWN;
    }
    (void)hwinfo_clear_reset_cause();
    if ((cause & RESET_WATCHDOG) != 0u) {
        return FK_RESET_WATCHDOG;
    }
    if ((cause & RESET_CPU_LOCKUP) != 0u) {
        return FK_RESET_LOCKUP;
    }
    if ((cause & RESET_SOFTWARE) != 0u) {
        return FK_RESET_SOFTWARE;
    }
    if ((cause & RESET_PIN) != 0u) {
        return FK_RESET_PIN;
    }
    return (cause == 0u) ? FK_RESET_POWER : FK_RESET_UNKNOWN; /* this chip records no cause for a power-on */
}

/* With a table that is not for this robot it answers all the same, and reports its fault; it starts no pulse. */
static void boot_robot(uint8_t reset)
{
    flash = fk_flash_region();
    (void)fk_store_boot(&store, &flash, fk_table_image, fk_table_image_bytes);
    (void)fk_robot_init(&robot, store.image, store.image_bytes);
    fk_robot_use_store(&robot, &store);
    fk_robot_note_reset(&robot, reset, &persistent);
    fk_robot_use_learned(&robot, &learned);
    fk_robot_use_log(&robot, &history);
}

BUILD_ASSERT(FK_RADIO_SEND_BYTES >= FK_FRAME_ENCODED_MAX, "the longest frame is taken at once");

/* No faster than the radio sends: until then frames wait in the core, which counts those that find no room. */
static void send_answers(void)
{
    fk_robot_note_frames_dropped(&robot, fk_radio_take_dropped_frames());
    if (fk_radio_is_sending() == 0) {
        const uint32_t length = fk_robot_take_tx(&robot, fk_radio_send_buffer(), FK_RADIO_SEND_BYTES);
        if (length > 0u) {
            fk_radio_send(length);
        }
    }
}

/* The host, as far as its connection tells. */
typedef enum {
    HOST_IS_HEARD, /* or has not connected since the start */
    HOST_HAS_LEFT, /* its connection has ended, and frames that it sent before may still wait */
    HOST_IS_GONE,  /* and none waits any more; from the next frame on there is another one */
} host_t;

/* Strokes are for an armed robot that is not in a run. */
static int32_t is_armed(void)
{
    return fk_robot_may(&robot, FK_EVENT_STROKE) == FK_STATUS_OK;
}

int main(void)
{
    const struct device *const watchdog = DEVICE_DT_GET(DT_NODELABEL(wdt0));

    if (fk_limbs_init(wake_up) != FK_LIMBS_OK) {
        printk("the limbs' timer or channels are taken: no pulse will start\n");
    }
    const int channel = start_watchdog(watchdog);
    if (channel < 0) {
        printk("no watchdog: error %d\n", channel);
        return 0;
    }
    const uint8_t reset = reset_reason();
    boot_robot(reset);
    fk_supply_init(wake_up);
    fk_battery_pins_init();
    const int32_t error = fk_radio_init(wake_up, (reset == FK_RESET_POWER) ? 1 : 0);
    if (error != 0) {
        printk("no radio: error %d\n", error);
    }

    host_t host = HOST_IS_HEARD;
    for (;;) {
        fk_outputs_t outputs;

        (void)wdt_feed(watchdog, channel);
        if (fk_radio_take_drop() != 0) {
            host = HOST_HAS_LEFT;
        }
        if (host != HOST_IS_HEARD) { /* each time, as a run that goes on without a host may end armed */
            fk_robot_note_link_lost(&robot);
        }
        const int32_t supply_is_low = fk_supply_is_low(fk_limbs_now_us());
        fk_robot_note_supply(&robot, (supply_is_low != 0 || fk_battery_pins_are_low() != 0) ? 1 : 0);
        const int32_t taken = take_frame();
        if (host == HOST_HAS_LEFT) { /* again, before a tick: an ARM among them must not keep the robot armed */
            fk_robot_note_link_lost(&robot);
            host = (taken != 0) ? HOST_HAS_LEFT : HOST_IS_GONE;
        } else if (taken != 0) {
            host = HOST_IS_HEARD;
        }
        const uint64_t begin_us = fk_limbs_now_us();
        fk_robot_tick(&robot, begin_us, &outputs); /* a decision computes for less than the watchdog waits */
        const int32_t at_once = drive_limbs(&outputs, begin_us);
        fk_battery_pins_service((outputs.limb_mask != 0u) ? 1 : 0);
        check_crystal();
        fk_robot_note_tick(&robot, (uint32_t)(fk_limbs_now_us() - begin_us));
        send_answers();

        const uint64_t after_us = fk_limbs_now_us();
        uint64_t sleep_us = (outputs.next_tick_us > after_us) ? outputs.next_tick_us - after_us : 0u;
        sleep_us = (sleep_us > LONGEST_SLEEP_US) ? LONGEST_SLEEP_US : sleep_us;
        if (at_once != 0 || taken != 0 || (host != HOST_IS_HEARD && is_armed() != 0)) {
            sleep_us = 0u;
        }
        (void)wdt_feed(watchdog, channel);
        (void)k_sem_take(&wake, K_USEC(sleep_us));
    }
}
