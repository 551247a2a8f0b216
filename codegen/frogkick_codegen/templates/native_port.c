/* native_port.c - what the core asks of its port, for the native target: flash for tables, which is memory of the host that
 * context points to; and bytes for nonces. */
#include "fk_auth.h"
#include "fk_store.h"

void fk_flash_erase(const fk_flash_t *flash, uint32_t offset)
{
    uint32_t *to = (uint32_t *)flash->context + offset / 4u;
    for (uint32_t i = 0u; i < FK_FLASH_PAGE_BYTES / 4u; ++i) {
        to[i] = UINT32_MAX;
    }
}

void fk_flash_program(const fk_flash_t *flash, uint32_t offset, const uint32_t *words, uint32_t count)
{
    uint32_t *to = (uint32_t *)flash->context + offset / 4u;
    for (uint32_t i = 0u; i < count; ++i) {
        to[i] &= words[i]; /* bits go to 0 only */
    }
}

/* A simulated robot has nothing to hide: no nonce comes twice, and that is enough. */
int32_t fk_port_random(uint8_t *bytes, uint32_t count)
{
    static uint32_t state;
    for (uint32_t i = 0u; i < count; ++i) {
        state = 1664525u * state + 1013904223u;
        bytes[i] = (uint8_t)(state >> 24);
    }
    return 0;
}
