/* native_flash.c - the native target's flash for tables: memory of the host, which context points to. */
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
