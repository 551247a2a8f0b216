#include "flash.h"

#include <zephyr/device.h>
#include <zephyr/devicetree.h>
#include <zephyr/drivers/flash.h>
#include <zephyr/storage/flash_map.h>
#include <zephyr/sys/util.h>

#define TABLES DT_NODELABEL(tables_partition)
#define JOURNAL_BYTES (FK_STORE_JOURNAL_PAGES * FK_FLASH_PAGE_BYTES)
#define SLOT_BYTES ((DT_REG_SIZE(TABLES) - JOURNAL_BYTES) / FK_STORE_SLOTS_MAX)

/* Without it the linker takes all 512 KB, and an image of more than the program's partition lies over the tables. */
#if !defined(CONFIG_USE_DT_CODE_PARTITION)
#error "set CONFIG_USE_DT_CODE_PARTITION=y: without it the image may lie over the tables"
#endif

BUILD_ASSERT(SLOT_BYTES % FK_FLASH_PAGE_BYTES == 0, "two slots of whole pages behind the journal");

static const struct device *const controller = DEVICE_DT_GET(DT_MTD_FROM_FIXED_PARTITION(TABLES));

fk_flash_t fk_flash_region(void)
{
    /* Flash begins at address 0 of this chip and is read there. */
    const fk_flash_t flash = {(const uint8_t *)(uintptr_t)DT_REG_ADDR(TABLES), SLOT_BYTES, FK_STORE_SLOTS_MAX, NULL};
    return flash;
}

/* Neither reports success, as the store reads back. The driver waits for gaps that the radio leaves. */
void fk_flash_erase(const fk_flash_t *flash, uint32_t offset)
{
    (void)flash;
    (void)flash_erase(controller, (off_t)(DT_REG_ADDR(TABLES) + offset), FK_FLASH_PAGE_BYTES);
}

void fk_flash_program(const fk_flash_t *flash, uint32_t offset, const uint32_t *words, uint32_t count)
{
    (void)flash;
    (void)flash_write(controller, (off_t)(DT_REG_ADDR(TABLES) + offset), words, sizeof(*words) * count);
}
