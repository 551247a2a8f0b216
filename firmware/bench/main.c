/* The bench robot: moves bytes, pins and time between the hardware and the core, nothing else. */
#include "battery.h"
#include "clock.h"
#include "fk_robot_state.h"
#include "fk_table.h"
#include "flash.h"
#include "pulse.h"
#include "sleep.h"
#include "supply.h"
#include "time.h"
#include "uart.h"
#include "watchdog.h"

/* While bytes arrive the loop reads them this often, about 11 at a time, instead of waking for each. */
#define FK_BENCH_RECEIVE_POLL_US 1000u

typedef char fk_late_is_late[(FK_PULSE_ERROR_LATE == FK_PULSE_LATE) ? 1 : -1];

static fk_robot_t robot;
static fk_frame_collector_t collector;
static fk_flash_t flash;
static fk_store_t store;
static fk_guard_persistent_t persistent __attribute__((section(".noinit")));
static fk_wear_persistent_t learned __attribute__((section(".noinit")));
static fk_log_t history __attribute__((section(".noinit")));

typedef enum { NOTHING, BYTES, FRAME } taken_t;

/* Takes one frame at most, so that between two feeds of the watchdog lie one command and one tick, however many
 * commands wait. */
static taken_t take_frame(void)
{
    taken_t taken = NOTHING;
    uint8_t byte;
    while (taken != FRAME && fk_uart_read(&byte) != 0) {
        taken = BYTES;
        uint32_t length = fk_frame_collect(&collector, byte);
        if (length > 0u) {
            fk_robot_on_frame(&robot, collector.bytes, length, fk_time_now_us());
            taken = FRAME;
        }
    }
    return taken;
}

/* Do what a tick's outputs say. For the guard the pulse begins at tick_us. A pulse that would begin more than
 * FK_PORT_LATE_US later does not begin, and the core refuses its stroke. Any other error is an internal error of
 * the robot, since the core asks for no pulse while one is on. Returns 1 where the core needs a tick at once. */
static int32_t drive_limbs(const fk_outputs_t *outputs, uint64_t tick_us)
{
    if (outputs->all_off != 0u) {
        fk_pulse_off();
    }
    if (outputs->limb_mask == 0u) {
        return 0;
    }
    int32_t error = fk_pulse_start(outputs->limb_mask, outputs->pulse_us, tick_us + FK_PORT_LATE_US);
    if (error != FK_PULSE_OK) {
        fk_robot_note_pulse_failed(&robot, error);
    }
    return error != FK_PULSE_OK;
}

/* Before any command is handled, so before ARM. */
static void check_crystal(void)
{
    if (fk_clock_is_exact() == 0) {
        fk_robot_note_clock_failed(&robot);
    }
}

static void send_answers(void)
{
    if (fk_uart_is_sending() == 0) {
        uint32_t length = fk_robot_take_tx(&robot, fk_uart_send_buffer(), FK_UART_BUFFER_BYTES);
        if (length > 0u) {
            fk_uart_send(length);
        }
    }
}

int main(void)
{
    fk_pulse_init();
    fk_watchdog_init();
    fk_clock_init();
    fk_time_init();
    fk_sleep_init();
    fk_supply_init();
    fk_battery_pins_init();
    /* Before the table is checked, which takes 0.4 ms for each KB: commands that arrive meanwhile wait in the
     * receive buffers. */
    fk_uart_init();
    /* With a table that is not for this robot it answers all the same, and reports its fault; it starts no pulse. */
    flash = fk_flash_region();
    (void)fk_store_boot(&store, &flash, fk_table_image, fk_table_image_bytes);
    (void)fk_robot_init(&robot, store.image, store.image_bytes);
    fk_robot_use_store(&robot, &store);
    fk_robot_note_reset(&robot, fk_watchdog_reset_reason(), &persistent);
    fk_robot_use_learned(&robot, &learned);
    fk_robot_use_log(&robot, &history);

    for (;;) {
        fk_watchdog_feed();
        fk_uart_service();
        fk_time_clear_wake();
        (void)fk_pulse_is_on();
        const int32_t supply_is_low = fk_supply_is_low();
        fk_sleep_clear_pending();
        fk_robot_note_supply(&robot, (supply_is_low != 0 || fk_battery_pins_are_low() != 0) ? 1 : 0);

        check_crystal();
        taken_t taken = take_frame();
        fk_outputs_t outputs;
        uint64_t begin_us = fk_time_now_us();
        fk_robot_tick(&robot, begin_us, &outputs);
        int32_t at_once = drive_limbs(&outputs, begin_us);
        fk_battery_pins_service(fk_pulse_is_on());
        fk_robot_note_tick(&robot, (uint32_t)(fk_time_now_us() - begin_us));
        send_answers();

        /* After a frame another one may wait. */
        uint64_t wake_us = (at_once != 0 || taken == FRAME) ? begin_us : outputs.next_tick_us;
        if (wake_us > begin_us + FK_WATCHDOG_FEED_MAX_US) {
            wake_us = begin_us + FK_WATCHDOG_FEED_MAX_US;
        }
        fk_uart_wake_on_byte(taken == NOTHING);
        if (taken != NOTHING && wake_us > begin_us + FK_BENCH_RECEIVE_POLL_US) {
            wake_us = begin_us + FK_BENCH_RECEIVE_POLL_US;
        }
        if (fk_time_wake_at(wake_us) != 0) {
            fk_sleep();
        }
    }
}
