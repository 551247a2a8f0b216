/* Driver test: echoes every byte, and obeys commands that begin with 0xFE:
 *   FE 01 mask low high   pulse on `mask` for low + 256 * high units of 10 us; answers FE 01 (result as a byte)
 *   FE 02 mask low high   the same, then hangs in an endless loop right after the start
 *   FE 03                 all gates off
 *   FE 04                 answers FE 04, overruns, line errors
 *   FE 05                 reads nothing for 60 ms, asleep
 */
#include "clock.h"
#include "pulse.h"
#include "sleep.h"
#include "time.h"
#include "uart.h"

#define ESCAPE 0xFEu
#define QUEUE_BYTES 2048u
#define UNREAD_US 60000u
#define LATEST_US 200u

static uint8_t queue[QUEUE_BYTES];
static uint32_t queue_in;
static uint32_t queue_out;

static uint8_t command[5];
static uint32_t command_bytes;

static void put(uint8_t byte)
{
    queue[queue_in % QUEUE_BYTES] = byte;
    ++queue_in;
}

static void obey(void)
{
    uint32_t pulse_us = 10u * (command[3] + 256u * (uint32_t)command[4]);
    if (command[1] == 1u || command[1] == 2u) {
        int32_t result = fk_pulse_start(command[2], pulse_us, fk_time_now_us() + LATEST_US);
        while (command[1] == 2u) {
            __asm__ volatile("");
        }
        put(ESCAPE);
        put(1u);
        put((uint8_t)result);
    } else if (command[1] == 3u) {
        fk_pulse_off();
    } else if (command[1] == 4u) {
        put(ESCAPE);
        put(4u);
        put((uint8_t)fk_uart_overruns());
        put((uint8_t)fk_uart_line_errors());
    } else {
        /* Only what becomes pending wakes: what is pending already must be taken back, and bytes kept quiet. */
        fk_uart_wake_on_byte(0);
        fk_time_clear_wake();
        fk_sleep_clear_pending();
        uint64_t until_us = fk_time_now_us() + UNREAD_US;
        while (fk_time_wake_at(until_us) != 0) {
            fk_sleep();
        }
        fk_uart_wake_on_byte(1);
    }
}

static void take(uint8_t byte)
{
    if (command_bytes == 0u && byte != ESCAPE) {
        put(byte);
        return;
    }
    command[command_bytes] = byte;
    ++command_bytes;
    uint32_t whole = (command_bytes >= 2u && command[1] >= 3u) ? 2u : 5u;
    if (command_bytes == whole) {
        command_bytes = 0u;
        obey();
    }
}

int main(void)
{
    fk_pulse_init();
    fk_clock_init();
    fk_time_init();
    fk_sleep_init();
    fk_uart_init();
    for (;;) {
        fk_uart_service();
        fk_time_clear_wake();
        (void)fk_pulse_is_on();
        fk_sleep_clear_pending();
        uint8_t byte;
        while (fk_uart_read(&byte) != 0) {
            take(byte);
        }
        if (fk_uart_is_sending() == 0 && queue_in != queue_out) {
            uint8_t *buffer = fk_uart_send_buffer();
            uint32_t length = 0u;
            while (length < FK_UART_BUFFER_BYTES && queue_in != queue_out) {
                buffer[length] = queue[queue_out % QUEUE_BYTES];
                ++queue_out;
                ++length;
            }
            fk_uart_send(length);
        }
        if (fk_time_wake_at(UINT64_MAX) != 0) {
            fk_sleep();
        }
    }
}
