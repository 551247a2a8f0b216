/* The robot on Zephyr: moves bytes, pins and time between the hardware and the core, nothing else. */
#include <zephyr/device.h>
#include <zephyr/devicetree.h>
#include <zephyr/drivers/hwinfo.h>
#include <zephyr/drivers/watchdog.h>
#include <zephyr/kernel.h>
#include <zephyr/sys/printk.h>

#include "fk_robot.h"
#include "fk_table.h"
#include "limbs.h"
#include "radio.h"

#define WATCHDOG_MS 1000u
#define LONGEST_SLEEP_US 400000u /* the watchdog is fed by this loop alone: where it hangs, the robot resets */
#define SEND_BYTES 244u          /* what one notification holds at most */

static fk_robot_t robot;
static fk_frame_collector_t collector;
static K_SEM_DEFINE(wake, 0, 1);

/* A pulse that the core has asked for while the one before it is still on. */
static uint8_t waiting_mask;
static uint32_t waiting_pulse_us;

static void wake_up(void)
{
    k_sem_give(&wake);
}

static uint64_t now_us(void)
{
    return k_ticks_to_us_floor64((uint64_t)k_uptime_ticks());
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

static void take_frames(void)
{
    uint8_t byte;

    while (fk_radio_read(&byte) != 0) {
        const uint32_t length = fk_frame_collect(&collector, byte);
        if (length > 0u) {
            fk_robot_on_frame(&robot, collector.bytes, length, now_us());
        }
    }
}

static void drive_limbs(const fk_outputs_t *outputs)
{
    if (outputs->all_off != 0u) {
        fk_limbs_off();
        waiting_mask = 0u;
    }
    if (outputs->limb_mask != 0u) {
        waiting_mask = outputs->limb_mask;
        waiting_pulse_us = outputs->pulse_us;
    }
    /* Busy: it waits, and the pulse's end wakes this loop. Any other refusal is final, no limb is heated. */
    if (waiting_mask != 0u && fk_limbs_pulse(waiting_mask, waiting_pulse_us) != FK_LIMBS_ERROR_BUSY) {
        waiting_mask = 0u;
    }
}

static void send_answers(void)
{
    uint8_t bytes[SEND_BYTES];
    uint32_t length = fk_robot_take_tx(&robot, bytes, sizeof(bytes));

    while (length > 0u) {
        fk_radio_send(bytes, length);
        length = fk_robot_take_tx(&robot, bytes, sizeof(bytes));
    }
}

int main(void)
{
    const struct device *const watchdog = DEVICE_DT_GET(DT_NODELABEL(wdt0));
    uint32_t reset_cause = 0u;

    (void)hwinfo_get_reset_cause(&reset_cause);
    (void)hwinfo_clear_reset_cause();
    printk("frogkick robot, reset cause 0x%x\n", reset_cause);
    if (fk_limbs_init(wake_up) != FK_LIMBS_OK) {
        printk("the limbs' timer or channels are taken: no pulse will start\n");
        return 0;
    }
    if (fk_robot_init(&robot, fk_table_image, fk_table_image_bytes) != FK_OK) {
        printk("the table is not for this robot: build the firmware again\n");
        return 0;
    }
    const int channel = start_watchdog(watchdog);
    if (channel < 0) {
        printk("no watchdog: error %d\n", channel);
        return 0;
    }
    const int32_t error = fk_radio_init(wake_up);
    if (error != 0) {
        printk("no radio: error %d\n", error);
    }

    for (;;) {
        fk_outputs_t outputs;

        (void)wdt_feed(watchdog, channel);
        take_frames();
        const uint64_t begin_us = now_us();
        fk_robot_tick(&robot, begin_us, &outputs);
        drive_limbs(&outputs);
        fk_robot_note_tick(&robot, (uint32_t)(now_us() - begin_us));
        send_answers();

        const uint64_t after_us = now_us();
        uint64_t sleep_us = (outputs.next_tick_us > after_us) ? outputs.next_tick_us - after_us : 0u;
        sleep_us = (sleep_us > LONGEST_SLEEP_US) ? LONGEST_SLEEP_US : sleep_us;
        (void)k_sem_take(&wake, K_USEC(sleep_us));
    }
}
