/* Bytes over the Nordic UART Service, one host at a time. Who may connect and write is decided here. */
#ifndef RADIO_H
#define RADIO_H

#include <stdint.h>

/* Start Bluetooth and advertise. `arrived` is called, not from an interrupt, when bytes are there to read.
 * @param after_power_on  1: the chip was switched on; after any other reset no new host may pair
 * @retval 0, or Zephyr's negative errno
 */
int32_t fk_radio_init(void (*arrived)(void), int32_t after_power_on);

/* Read the next received byte.
 * @retval 1  a byte was read
 * @retval 0  there is none
 */
int32_t fk_radio_read(uint8_t *byte);

/* @retval 1  a connection has ended since the last call */
int32_t fk_radio_take_drop(void);

#define FK_RADIO_SEND_BYTES 256u /* whole frames, of 240 bytes at most */

/* @retval 1  the last bytes still wait for the radio
 * @retval 0  it accepts more
 */
int32_t fk_radio_is_sending(void);

/* A buffer of FK_RADIO_SEND_BYTES bytes to fill for fk_radio_send(), while fk_radio_is_sending() is 0. */
uint8_t *fk_radio_send_buffer(void);

/* Let a thread send the first `length` bytes of that buffer, which are whole frames. Returns at once; `arrived` is
 * called when the radio accepts more. A frame that cannot be sent completely is dropped; where a part of it had been
 * sent already, a delimiter ends it, so that it does not damage the next one.
 */
void fk_radio_send(uint32_t length);

/* @retval  frames that were dropped since the last call because no host listened or the connection ended */
uint32_t fk_radio_take_dropped_frames(void);

#endif
