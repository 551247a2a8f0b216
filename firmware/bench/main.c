/* The bench robot: moves bytes, pins and time between the hardware and the core, nothing else. */
#include "clock.h"
#include "fk_robot.h"
#include "fk_table.h"
#include "pulse.h"
#include "sleep.h"
#include "time.h"
#include "uart.h"

/* While bytes arrive the core looks at them this often, about 11 bytes at a time, instead of waking for each. */
#define FK_BENCH_RECEIVE_POLL_US 1000u

static fk_robot_t robot;
static fk_frame_collector_t collector;

/* A pulse that the core has asked for while the pulse before it is still on: a decision's computing time delays the
 * first group of a stroke, but not the time of the second. It starts as soon as the gates are free. */
static uint8_t waiting_mask;
static uint32_t waiting_pulse_us;

static int32_t take_frames(void)
{
    int32_t bytes = 0;
    uint8_t byte;
    while (fk_uart_read(&byte) != 0) {
        bytes = 1;
        uint32_t length = fk_frame_collect(&collector, byte);
        if (length > 0u) {
            fk_robot_on_frame(&robot, collector.bytes, length, fk_time_now_us());
        }
    }
    return bytes;
}

static void drive_limbs(const fk_outputs_t *outputs)
{
    if (outputs->all_off != 0u) {
        fk_pulse_off();
        waiting_mask = 0u;
    }
    if (outputs->limb_mask != 0u) {
        waiting_mask = outputs->limb_mask;
        waiting_pulse_us = outputs->pulse_us;
    }
    /* Busy: it waits, and the pulse's end wakes the core. Any other refusal is final, no limb is heated. */
    if (waiting_mask != 0u && fk_pulse_start(waiting_mask, waiting_pulse_us) != FK_PULSE_ERROR_BUSY) {
        waiting_mask = 0u;
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
    fk_clock_init();
    fk_time_init();
    fk_sleep_init();
    /* Before the table is checked, 0.4 ms for each KB of it: what is asked meanwhile waits in the receive buffers. */
    fk_uart_init();
    if (fk_robot_init(&robot, fk_table_image, fk_table_image_bytes) != FK_OK) {
        for (;;) { /* a table that is not for this robot: no answer, no pulse */
            fk_sleep();
        }
    }

    for (;;) {
        fk_uart_service();
        fk_time_clear_wake();
        (void)fk_pulse_is_on();
        fk_sleep_clear_pending();

        int32_t bytes = take_frames();
        fk_outputs_t outputs;
        uint64_t begin_us = fk_time_now_us();
        fk_robot_tick(&robot, begin_us, &outputs);
        drive_limbs(&outputs);
        fk_robot_note_tick(&robot, (uint32_t)(fk_time_now_us() - begin_us));
        send_answers();

        uint64_t wake_us = outputs.next_tick_us;
        fk_uart_wake_on_byte(bytes == 0);
        if (bytes != 0 && wake_us > begin_us + FK_BENCH_RECEIVE_POLL_US) {
            wake_us = begin_us + FK_BENCH_RECEIVE_POLL_US;
        }
        if (fk_time_wake_at(wake_us) != 0) {
            fk_sleep();
        }
    }
}
