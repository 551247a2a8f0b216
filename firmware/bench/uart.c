#include "uart.h"

#include "board.h"
#include "nrf52832_regs.h"
#include "ppi_channels.h"
#include "time.h"

#define COUNT_TIMER TIMER1_BASE
#define CC_COUNT 0u
#define STOP_WAIT_MAX_US 1000u /* RXTO comes four byte times after STOPRX: 347 us */
#define DMA_SETTLE_LOOPS 16u   /* at least 32 cycles, 0.5 us: RXDRDY may come before EasyDMA has written the byte */

/* Two receive buffers in turn. The hardware fills one; the ENDRX -> STARTRX short starts the other, whose address
 * was put into RXD.PTR during the first one's time. Which byte is where follows from the number of bytes received,
 * which TIMER1 counts without the core. */
static uint8_t receive_buffer[2][FK_UART_BUFFER_BYTES];
static uint32_t fill;           /* the buffer that the hardware fills, as far as noticed */
static uint32_t fill_begin;     /* count of received bytes where that fill began */
static uint32_t read_count;     /* bytes read so far, modulo 2^32 as all counts */

static uint8_t transmit_buffer[FK_UART_BUFFER_BYTES];
static uint8_t is_sending;

static uint32_t overruns;
static uint32_t line_errors;

static uint32_t received_count(void)
{
    TIMER_TASKS_CAPTURE(COUNT_TIMER, CC_COUNT) = 1u;
    return TIMER_CC(COUNT_TIMER, CC_COUNT);
}

static void begin_reception(void)
{
    TIMER_TASKS_CLEAR(COUNT_TIMER) = 1u;
    fill = 0u;
    fill_begin = 0u;
    read_count = 0u;
    UARTE0_EVENTS_RXSTARTED = 0u;
    UARTE0_RXD_PTR = (uint32_t)(uintptr_t)receive_buffer[0];
    UARTE0_RXD_MAXCNT = FK_UART_BUFFER_BYTES;
    UARTE0_ENABLE = UARTE0_ENABLE_ENABLE_Enabled;
    UARTE0_SHORTS = UARTE0_SHORTS_ENDRX_STARTRX_Msk;
    UARTE0_TASKS_STARTRX = 1u;
    while (UARTE0_EVENTS_RXSTARTED == 0u) {
    }
    UARTE0_RXD_PTR = (uint32_t)(uintptr_t)receive_buffer[1]; /* latched by the next start */
}

/* Bytes were overwritten unread, or it is unknown which buffer the hardware took: begin anew. */
static void restart_reception(void)
{
    ++overruns;
    UARTE0_SHORTS = 0u;
    UARTE0_EVENTS_RXTO = 0u;
    UARTE0_TASKS_STOPRX = 1u;
    uint64_t until_us = fk_time_now_us() + STOP_WAIT_MAX_US;
    while (UARTE0_EVENTS_RXTO == 0u && fk_time_now_us() < until_us) {
    }
    /* A transmission under way would be cut by the disable below: let it end, it takes 22 ms at the most. */
    while (is_sending != 0u) {
        fk_uart_service();
    }
    UARTE0_ENABLE = UARTE0_ENABLE_ENABLE_Disabled; /* also empties the receiver's FIFO */
    begin_reception();
}

void fk_uart_init(void)
{
    P0_OUTSET = 1u << FK_BOARD_UART_TX_PIN; /* an idle line is high */
    P0_PIN_CNF(FK_BOARD_UART_TX_PIN) =
        (P0_PIN_CNF_DIR_Output << P0_PIN_CNF_DIR_Pos) | (P0_PIN_CNF_INPUT_Disconnect << P0_PIN_CNF_INPUT_Pos);
    /* Pulled up: an open receive line is idle, not a break. */
    P0_PIN_CNF(FK_BOARD_UART_RX_PIN) = (P0_PIN_CNF_DIR_Input << P0_PIN_CNF_DIR_Pos) |
                                       (P0_PIN_CNF_INPUT_Connect << P0_PIN_CNF_INPUT_Pos) |
                                       (P0_PIN_CNF_PULL_Pullup << P0_PIN_CNF_PULL_Pos);
    UARTE0_PSEL_TXD = FK_BOARD_UART_TX_PIN;
    UARTE0_PSEL_RXD = FK_BOARD_UART_RX_PIN;
    UARTE0_BAUDRATE = UARTE0_BAUDRATE_BAUDRATE_Baud115200;

    TIMER_MODE(COUNT_TIMER) = TIMER_MODE_MODE_LowPowerCounter;
    TIMER_BITMODE(COUNT_TIMER) = TIMER_BITMODE_BITMODE_32Bit;
    TIMER_TASKS_START(COUNT_TIMER) = 1u;
    PPI_CH_EEP(FK_PPI_UART_COUNT) = FK_ADDRESS_OF(UARTE0_EVENTS_RXDRDY);
    PPI_CH_TEP(FK_PPI_UART_COUNT) = FK_ADDRESS_OF(TIMER_TASKS_COUNT(COUNT_TIMER));
    PPI_CHENSET = 1u << FK_PPI_UART_COUNT;

    UARTE0_INTENSET = UARTE0_INTENSET_RXDRDY_Msk | UARTE0_INTENSET_ENDTX_Msk;
    is_sending = 0u;
    overruns = 0u;
    line_errors = 0u;
    begin_reception();
}

void fk_uart_service(void)
{
    UARTE0_EVENTS_RXDRDY = 0u;
    if (UARTE0_EVENTS_ENDTX != 0u) {
        UARTE0_EVENTS_ENDTX = 0u;
        is_sending = 0u;
    }
    if (UARTE0_EVENTS_ERROR != 0u) {
        UARTE0_EVENTS_ERROR = 0u;
        UARTE0_ERRORSRC = UARTE0_ERRORSRC; /* writing a one clears it */
        ++line_errors;
    }
    (void)UARTE0_EVENTS_RXDRDY; /* the writes have arrived before the caller goes on */
}

int32_t fk_uart_read(uint8_t *byte)
{
    uint32_t count = received_count();
    if (count - fill_begin >= FK_UART_BUFFER_BYTES) {
        /* The hardware has gone on to the other buffer. Queue the one it left, for the start after this one. */
        fill_begin += FK_UART_BUFFER_BYTES;
        fill ^= 1u;
        UARTE0_RXD_PTR = (uint32_t)(uintptr_t)receive_buffer[fill ^ 1u];
        count = received_count();
        if (count - fill_begin >= FK_UART_BUFFER_BYTES) {
            /* That start has been already: too late, or just while RXD.PTR was written. */
            restart_reception();
            return 0;
        }
    }
    uint32_t unread = count - read_count;
    uint32_t filled = count - fill_begin;
    if (unread == 0u) {
        return 0;
    }
    if (unread > filled + FK_UART_BUFFER_BYTES) {
        restart_reception(); /* the hardware writes over bytes of the fill before the last */
        return 0;
    }
    if (unread == 1u) {
        for (uint32_t i = 0u; i < DMA_SETTLE_LOOPS; ++i) {
            __asm__ volatile("nop");
        }
    }
    if (unread <= filled) {
        *byte = receive_buffer[fill][read_count - fill_begin];
    } else {
        *byte = receive_buffer[fill ^ 1u][read_count - (fill_begin - FK_UART_BUFFER_BYTES)];
    }
    ++read_count;
    return 1;
}

void fk_uart_wake_on_byte(int32_t wakes)
{
    if (wakes != 0) {
        UARTE0_INTENSET = UARTE0_INTENSET_RXDRDY_Msk;
    } else {
        UARTE0_INTENCLR = UARTE0_INTENCLR_RXDRDY_Msk;
    }
}

int32_t fk_uart_is_sending(void) { return is_sending; }

uint8_t *fk_uart_send_buffer(void) { return transmit_buffer; }

void fk_uart_send(uint32_t length)
{
    is_sending = 1u;
    UARTE0_TXD_PTR = (uint32_t)(uintptr_t)transmit_buffer;
    UARTE0_TXD_MAXCNT = length;
    UARTE0_TASKS_STARTTX = 1u;
}

uint32_t fk_uart_overruns(void) { return overruns; }

uint32_t fk_uart_line_errors(void) { return line_errors; }
