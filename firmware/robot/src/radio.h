/* Bytes over the Nordic UART Service, one host at a time. Who may connect and write is decided here. */
#ifndef RADIO_H
#define RADIO_H

#include <stdint.h>

/* Start Bluetooth and advertise. `arrived` is called, not from an interrupt, when bytes are there to read.
 * @retval 0, or Zephyr's negative errno
 */
int32_t fk_radio_init(void (*arrived)(void));

/* @retval 1 a byte was read, 0 there is none */
int32_t fk_radio_read(uint8_t *byte);

/* @retval 1 a connection has ended since the last call */
int32_t fk_radio_take_drop(void);

/* Send to the host; waits for buffers, never for the host. Dropped where no host listens. */
void fk_radio_send(const uint8_t *bytes, uint32_t length);

#endif
