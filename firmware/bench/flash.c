#include "flash.h"

#include "nrf52832_regs.h"

/* Slots for tables, and bytes of each, whole pages; 'frogkick firmware build' says what fits beside its table. */
#ifndef FK_BOARD_SLOTS
#define FK_BOARD_SLOTS 2u
#define FK_BOARD_SLOT_BYTES 65536u
#endif
#define STORE_BYTES (FK_STORE_JOURNAL_PAGES * FK_FLASH_PAGE_BYTES + FK_BOARD_SLOTS * FK_BOARD_SLOT_BYTES)

typedef char fk_board_slots_fit[(FK_BOARD_SLOTS >= 1u && FK_BOARD_SLOTS <= FK_STORE_SLOTS_MAX) ? 1 : -1];
typedef char fk_board_slot_is_pages[(FK_BOARD_SLOT_BYTES % FK_FLASH_PAGE_BYTES == 0u) ? 1 : -1];

/* nrf52832.ld puts it in flash, on a page, and loads nothing there. */
static uint8_t region[STORE_BYTES] __attribute__((section(".store"), aligned(FK_FLASH_PAGE_BYTES)));

fk_flash_t fk_flash_region(void)
{
    fk_flash_t flash = {region, FK_BOARD_SLOT_BYTES, FK_BOARD_SLOTS, 0};
    return flash;
}

static uint32_t address_of(const fk_flash_t *flash, uint32_t offset)
{
    return (uint32_t)(uintptr_t)flash->base + offset;
}

/* The processor runs from flash, so it stalls until NVMC is done: at most 89.7 ms for a page and 338 us for a
 * word. */
static void wait_until_ready(void)
{
    while (NVMC_READY == NVMC_READY_READY_Busy) {
    }
}

void fk_flash_erase(const fk_flash_t *flash, uint32_t offset)
{
    NVMC_CONFIG = NVMC_CONFIG_WEN_Een;
    wait_until_ready();
    NVMC_ERASEPAGE = address_of(flash, offset);
    wait_until_ready();
    NVMC_CONFIG = NVMC_CONFIG_WEN_Ren;
    wait_until_ready();
}

void fk_flash_program(const fk_flash_t *flash, uint32_t offset, const uint32_t *words, uint32_t count)
{
    NVMC_CONFIG = NVMC_CONFIG_WEN_Wen;
    wait_until_ready();
    for (uint32_t i = 0u; i < count; ++i) {
        FK_REGISTER(address_of(flash, offset + 4u * i)) = words[i];
        wait_until_ready();
    }
    NVMC_CONFIG = NVMC_CONFIG_WEN_Ren;
    wait_until_ready();
}
