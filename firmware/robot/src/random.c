/* Random bytes for the nonces of fk_auth.h, from Bluetooth's generator: they are asked for by frames, so it runs. */
#include <stddef.h> /* before crypto.h, which uses size_t without it */
#include <stdint.h>

#include <zephyr/bluetooth/crypto.h>

#include "fk_auth.h"

int32_t fk_port_random(uint8_t *bytes, uint32_t count)
{
    return (bt_rand(bytes, count) == 0) ? 0 : -1;
}
