/* zephyr/bluetooth/crypto.h, which includes no more than this in 3.7: whoever includes it brings size_t. */
#ifndef CRYPTO_H
#define CRYPTO_H

#include <stdbool.h>

int bt_rand(void *buf, size_t len);

#endif
