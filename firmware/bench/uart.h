/* UARTE0, 115200 baud, 8 data bits, no parity, 1 stop bit, polled; bytes travel by EasyDMA. */
#ifndef UART_H
#define UART_H

#include <stdint.h>

/* RXD.MAXCNT and TXD.MAXCNT of the nRF52832 have 8 bits. */
#define FK_UART_BUFFER_BYTES 255u

void fk_uart_init(void);

/* Clear events, and note the end of a transmission. Call it before fk_uart_read(), so that a byte that arrives
 * later wakes the processor. */
void fk_uart_service(void);

/* Take the next received byte. At least 255 bytes (22 ms) are kept while none is read. Beyond that all unread bytes
 * are dropped, which fk_uart_overruns() counts; a frame that lacks some fails its CRC-32.
 * @retval 1  a byte was taken
 * @retval 0  none is there
 */
int32_t fk_uart_read(uint8_t *byte);

/* Whether the next received byte wakes the processor. */
void fk_uart_wake_on_byte(int32_t wakes);

/* 1 while a transmission is under way: leave the transmit buffer alone. */
int32_t fk_uart_is_sending(void);

/* FK_UART_BUFFER_BYTES bytes to fill for fk_uart_send. */
uint8_t *fk_uart_send_buffer(void);

/* Send the first `length` bytes of the transmit buffer, 1 to FK_UART_BUFFER_BYTES, while none is under way. */
void fk_uart_send(uint32_t length);

/* How often received bytes were dropped because they were not read in time. */
uint32_t fk_uart_overruns(void);

/* How often the line showed a framing error, a break or an overrun. */
uint32_t fk_uart_line_errors(void);

#endif
