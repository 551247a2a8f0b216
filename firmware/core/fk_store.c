#include "fk_store.h"

#include "fk_fit.h"
#include "fk_frames_layout.h"
#include "fk_journal.h"

static uint32_t slot_offset(const fk_store_t *store, uint32_t slot)
{
    return FK_STORE_JOURNAL_PAGES * FK_FLASH_PAGE_BYTES + (slot - 1u) * store->flash->slot_bytes;
}

int8_t fk_store_own(fk_store_t *store, const uint32_t key[FK_STORE_KEY_WORDS])
{
    fk_store_record_t next = store->record;
    uint32_t differing = 0u;
    for (uint32_t i = 0u; i < FK_STORE_KEY_WORDS; ++i) {
        differing |= key[i] ^ next.owner_key[i];
        next.owner_key[i] = key[i];
    }
    return (differing == 0u && store->lost == 0u) ? (int8_t)FK_STATUS_OK : fk_journal_append(store, &next);
}

int32_t fk_store_is_owned(const fk_store_t *store)
{
    uint32_t bits = 0u;
    for (uint32_t i = 0u; i < FK_STORE_KEY_WORDS; ++i) {
        bits |= store->record.owner_key[i];
    }
    return (bits != 0u || store->lost != 0u) ? 1 : 0;
}

/* A table's bytes: image and length; length 0 where a slot holds none. */
static const uint8_t *image_of(const fk_store_t *store, uint32_t table, uint32_t *length)
{
    if (table == FK_STORE_BUILT_IN) {
        *length = store->built_in_bytes;
        return store->built_in;
    }
    *length = store->record.length[table - 1u];
    return store->flash->base + slot_offset(store, table);
}

uint32_t fk_store_crc32(const fk_store_t *store, uint8_t table)
{
    return (table == FK_STORE_BUILT_IN) ? fk_get_u32(store->built_in + 12) : store->record.crc32[table - 1u];
}

/* Whether a table is whole, for this robot, and the one that was committed. */
static int32_t check_table(const fk_store_t *store, uint8_t table)
{
    fk_tables_t tables;
    uint32_t length;
    const uint8_t *image = image_of(store, table, &length);
    int32_t error = fk_fit_open(image, length, &tables);
    if (error == FK_OK && tables.image_crc32 != fk_store_crc32(store, table)) {
        error = FK_ERROR_IMAGE_CRC;
    }
    return error;
}

static void use_table(fk_store_t *store, uint8_t table)
{
    store->running = table;
    store->image = image_of(store, table, &store->image_bytes);
}

int32_t fk_store_boot(fk_store_t *store, const fk_flash_t *flash, const uint8_t *built_in, uint32_t built_in_bytes)
{
    store->flash = flash;
    store->built_in = built_in;
    store->built_in_bytes = built_in_bytes;
    store->open = 0u;
    store->begun = 0u;
    store->next_offset = 0u;
    fk_journal_read(store);
    if (store->in_doubt != 0u) {
        fk_store_record_t next = store->record;
        ++next.repairs;
        (void)fk_journal_append(store, &next); /* a flash that does not hold it is in doubt again at the next boot */
    }
    const uint8_t tables[3] = {store->record.active, store->record.previous, FK_STORE_BUILT_IN};
    int32_t error = FK_OK;
    for (uint32_t i = 0u; i < 3u; ++i) {
        error = check_table(store, tables[i]);
        use_table(store, tables[i]);
        if (error == FK_OK) {
            break;
        }
    }
    return error;
}

static int32_t is_worn(const fk_store_record_t *record, uint8_t slot)
{
    return record->erases[slot - 1u] >= FK_FLASH_ERASES_MAX;
}

/* The slot for an update: neither the one in use nor a worn one, and the previous table's only where there is no
 * other. 0: none. */
static uint8_t free_slot(const fk_store_t *store)
{
    uint8_t found = 0u;
    for (uint8_t slot = 1u; slot <= store->flash->slots; ++slot) {
        if (slot != store->running && !is_worn(&store->record, slot) &&
            (found == 0u || found == store->record.previous)) {
            found = slot;
        }
    }
    return found;
}

static int32_t is_same_upload(const fk_store_record_t *record, uint32_t length, const uint32_t *hash)
{
    if (record->pending == 0u || record->length[record->pending - 1u] != length) {
        return 0;
    }
    for (uint32_t i = 0u; i < FK_SHA256_WORDS; ++i) {
        if (record->hash[i] != hash[i]) {
            return 0;
        }
    }
    return 1;
}

int8_t fk_store_begin(fk_store_t *store, uint32_t length, const uint32_t hash[FK_SHA256_WORDS])
{
    fk_store_record_t next = store->record;
    store->open = 0u;
    if (length < FK_IMAGE_HEADER_BYTES || length > store->flash->slot_bytes || length % 4u != 0u) {
        return FK_STATUS_VALUE;
    }
    if (!is_same_upload(&next, length, hash) || is_worn(&next, next.pending)) {
        next.pending = free_slot(store);
        if (next.pending == 0u) {
            return (store->running != FK_STORE_BUILT_IN && store->flash->slots == 1u) ? FK_STATUS_SLOT : FK_STATUS_WORN;
        }
        next.pages_done = 0u;
        next.length[next.pending - 1u] = length;
        next.crc32[next.pending - 1u] = 0u;
        for (uint32_t i = 0u; i < FK_SHA256_WORDS; ++i) {
            next.hash[i] = hash[i];
        }
    }
    /* What is true when the record is written: boot may have fallen back to another table, and the slot's table is
     * given up. */
    next.active = store->running;
    if (next.previous == next.pending || next.previous == next.active) {
        next.previous = FK_STORE_BUILT_IN;
    }
    store->update = next;
    store->begun = 0u;
    store->open = 1u;
    store->next_offset = next.pages_done * FK_FLASH_PAGE_BYTES;
    return FK_STATUS_OK;
}

/* Write the update's record before the first of its pages is erased, so that each erase of the slot is counted. */
static int8_t write_update(fk_store_t *store)
{
    ++store->update.erases[store->update.pending - 1u];
    store->begun = 1u;
    return fk_journal_append(store, &store->update);
}

/* Write a chunk and, where it completes a page, the record of that. */
static int8_t write_chunk(fk_store_t *store, const uint8_t *bytes, uint32_t count)
{
    uint32_t words[FK_STORE_CHUNK_BYTES / 4u] = {0u};
    uint32_t at = slot_offset(store, store->update.pending) + store->next_offset;
    for (uint32_t i = 0u; i < count / 4u; ++i) {
        words[i] = fk_get_u32(bytes + 4u * i);
    }
    if (store->begun == 0u && write_update(store) != FK_STATUS_OK) {
        return FK_STATUS_FLASH;
    }
    if (store->next_offset % FK_FLASH_PAGE_BYTES == 0u && fk_journal_erase(store, at) != FK_STATUS_OK) {
        return FK_STATUS_FLASH;
    }
    if (fk_journal_program(store, at, words, count / 4u) != FK_STATUS_OK) {
        return FK_STATUS_FLASH;
    }
    store->next_offset += count;
    if (store->next_offset % FK_FLASH_PAGE_BYTES == 0u) {
        fk_store_record_t next = store->record;
        next.pages_done = (uint8_t)(store->next_offset / FK_FLASH_PAGE_BYTES);
        return fk_journal_append(store, &next);
    }
    return FK_STATUS_OK;
}

int8_t fk_store_chunk(fk_store_t *store, uint32_t offset, const uint8_t *bytes, uint32_t count)
{
    if (store->open == 0u) {
        return FK_STATUS_STATE;
    }
    if (offset != store->next_offset) {
        return FK_STATUS_OFFSET;
    }
    uint32_t left = store->update.length[store->update.pending - 1u] - offset;
    if (count == 0u || count != ((left < FK_STORE_CHUNK_BYTES) ? left : FK_STORE_CHUNK_BYTES)) {
        return FK_STATUS_LENGTH;
    }
    int8_t status = write_chunk(store, bytes, count);
    if (status != FK_STATUS_OK) {
        store->open = 0u;
    }
    return status;
}

/* What has arrived, read back from flash: the image that was announced, and a table that may drive this robot. */
static int8_t verify(const fk_store_t *store, uint32_t *crc32, int8_t *error)
{
    fk_tables_t tables;
    uint32_t digest[FK_SHA256_WORDS];
    uint32_t length;
    const uint8_t *image = image_of(store, store->record.pending, &length);
    fk_sha256(image, length, digest);
    for (uint32_t i = 0u; i < FK_SHA256_WORDS; ++i) {
        if (digest[i] != store->record.hash[i]) {
            return FK_STATUS_HASH;
        }
    }
    *error = (int8_t)fk_fit_open(image, length, &tables);
    if (*error != FK_OK) {
        return FK_STATUS_TABLE;
    }
    *crc32 = tables.image_crc32;
    return FK_STATUS_OK;
}

int8_t fk_store_commit(fk_store_t *store, int8_t *error)
{
    /* An update whose last page was done before a reset is committed without another chunk. */
    fk_store_record_t next = (store->open != 0u && store->begun == 0u) ? store->update : store->record;
    uint8_t slot = next.pending;
    *error = FK_OK;
    if (store->open == 0u || store->next_offset != next.length[slot - 1u]) {
        return FK_STATUS_STATE;
    }
    store->open = 0u;
    int8_t status = verify(store, &next.crc32[slot - 1u], error);
    next.pending = 0u;
    if (status != FK_STATUS_OK) {
        next.length[slot - 1u] = 0u;
        /* The upload cannot be continued; if this fails too, the table stays unused. */
        (void)fk_journal_append(store, &next);
        return status;
    }
    next.previous = store->running;
    next.active = slot;
    if (fk_journal_append(store, &next) != FK_STATUS_OK) {
        return FK_STATUS_FLASH;
    }
    use_table(store, slot);
    return FK_STATUS_OK;
}

int8_t fk_store_rollback(fk_store_t *store, uint32_t crc32, int8_t *error)
{
    fk_store_record_t next = store->record;
    uint8_t table = next.previous;
    *error = FK_OK;
    store->open = 0u;
    if (fk_store_crc32(store, store->running) == crc32) {
        return FK_STATUS_OK;
    }
    if (fk_store_crc32(store, table) != crc32) {
        table = FK_STORE_BUILT_IN;
    }
    if (fk_store_crc32(store, table) != crc32) {
        return FK_STATUS_VALUE;
    }
    *error = (int8_t)check_table(store, table);
    if (*error != FK_OK) {
        return FK_STATUS_TABLE;
    }
    next.previous = store->running;
    next.active = table;
    if (fk_journal_append(store, &next) != FK_STATUS_OK) {
        return FK_STATUS_FLASH;
    }
    use_table(store, table);
    return FK_STATUS_OK;
}
