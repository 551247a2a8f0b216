#include "fk_store.h"

#include "fk_fit.h"
#include "fk_frames_layout.h"

typedef union {
    fk_store_record_t record;
    uint32_t words[FK_STORE_RECORD_WORDS];
} fk_store_words_t;

static uint32_t word_at(const fk_store_t *store, uint32_t offset) { return fk_get_u32(store->flash->base + offset); }

static uint32_t slot_offset(const fk_store_t *store, uint32_t slot)
{
    return FK_STORE_JOURNAL_PAGES * FK_FLASH_PAGE_BYTES + (slot - 1u) * store->flash->slot_bytes;
}

static uint32_t layout_of(const fk_flash_t *flash) { return flash->slot_bytes + flash->slots; }

/* Erase a page and read it back. */
static int8_t erase_page(const fk_store_t *store, uint32_t offset)
{
    fk_flash_erase(store->flash, offset);
    for (uint32_t at = 0u; at < FK_FLASH_PAGE_BYTES; at += 4u) {
        if (word_at(store, offset + at) != UINT32_MAX) {
            return FK_STATUS_FLASH;
        }
    }
    return FK_STATUS_OK;
}

static int8_t program(const fk_store_t *store, uint32_t offset, const uint32_t *words, uint32_t count)
{
    fk_flash_program(store->flash, offset, words, count);
    for (uint32_t i = 0u; i < count; ++i) {
        if (word_at(store, offset + 4u * i) != words[i]) {
            return FK_STATUS_FLASH;
        }
    }
    return FK_STATUS_OK;
}

static uint32_t check_of(const fk_store_words_t *words)
{
    return fk_crc32(0u, (const uint8_t *)words->words, FK_STORE_RECORD_BYTES - 4u);
}

/* Read an entry of the journal. Returns 0: never written; 1: written, but not a valid record; 2: a valid record. */
static int32_t read_entry(const fk_store_t *store, uint32_t page, uint32_t place, fk_store_words_t *words)
{
    uint32_t offset = page * FK_FLASH_PAGE_BYTES + place * FK_STORE_RECORD_BYTES;
    int32_t kind = 0;
    for (uint32_t i = 0u; i < FK_STORE_RECORD_WORDS; ++i) {
        words->words[i] = word_at(store, offset + 4u * i);
        kind |= (words->words[i] != UINT32_MAX) ? 1 : 0;
    }
    if (words->record.magic == FK_STORE_MAGIC && words->record.layout == layout_of(store->flash) &&
        words->record.check == check_of(words)) {
        kind = 2;
    }
    return kind;
}

/* Find the newest valid record and the entry for the next one. */
static void read_journal(fk_store_t *store)
{
    static const fk_store_words_t nothing = {.words = {0u}};
    store->record = nothing.record;
    store->sequence = 0u;
    store->newest_page = FK_STORE_JOURNAL_PAGES - 1u; /* without any record the first goes to page 0, erased */
    store->page = store->newest_page;
    store->place = FK_STORE_RECORDS;
    for (uint32_t page = 0u; page < FK_STORE_JOURNAL_PAGES; ++page) {
        for (uint32_t place = 0u; place < FK_STORE_RECORDS; ++place) {
            fk_store_words_t words;
            int32_t kind = read_entry(store, page, place, &words);
            if (kind == 2 && words.record.sequence > store->record.sequence) {
                store->record = words.record;
                store->sequence = words.record.sequence;
                store->newest_page = page;
                store->page = page;
                store->place = place + 1u;
            } else if (kind == 1 && store->page == page && store->place < FK_STORE_RECORDS) {
                /* Behind the newest one, and cut off while it was written. Its bits may be marginal and read as a
                 * valid record at another boot, so its sequence number and its entry are used up. */
                store->sequence += place + 1u - store->place;
                store->place = place + 1u;
            }
        }
    }
}

/* Append a record. The step that it stands for has happened when its last word is written, and not before. */
static int8_t append(fk_store_t *store, const fk_store_record_t *next)
{
    fk_store_words_t words;
    words.record = *next;
    if (store->place >= FK_STORE_RECORDS) {
        /* Never the page that holds the newest valid record. */
        uint32_t page = FK_STORE_JOURNAL_PAGES - 1u - store->newest_page;
        if (erase_page(store, page * FK_FLASH_PAGE_BYTES) != FK_STATUS_OK) {
            return FK_STATUS_FLASH;
        }
        ++store->record.journal_erases;
        words.record.journal_erases = store->record.journal_erases;
        store->page = page;
        store->place = 0u;
    }
    uint32_t offset = store->page * FK_FLASH_PAGE_BYTES + store->place * FK_STORE_RECORD_BYTES;
    ++store->place;
    ++store->sequence;
    words.record.magic = FK_STORE_MAGIC;
    words.record.layout = layout_of(store->flash);
    words.record.sequence = store->sequence;
    words.record.check = check_of(&words);
    if (program(store, offset, words.words, FK_STORE_RECORD_WORDS) != FK_STATUS_OK) {
        return FK_STATUS_FLASH;
    }
    store->record = words.record;
    store->newest_page = store->page;
    return FK_STATUS_OK;
}

int8_t fk_store_own(fk_store_t *store, const uint32_t key[FK_STORE_KEY_WORDS])
{
    fk_store_record_t next = store->record;
    uint32_t differing = 0u;
    for (uint32_t i = 0u; i < FK_STORE_KEY_WORDS; ++i) {
        differing |= key[i] ^ next.owner_key[i];
        next.owner_key[i] = key[i];
    }
    return (differing == 0u) ? (int8_t)FK_STATUS_OK : append(store, &next);
}

int32_t fk_store_is_owned(const fk_store_t *store)
{
    uint32_t bits = 0u;
    for (uint32_t i = 0u; i < FK_STORE_KEY_WORDS; ++i) {
        bits |= store->record.owner_key[i];
    }
    return (bits != 0u) ? 1 : 0;
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
    read_journal(store);
    const uint8_t tables[3] = {store->record.active, store->record.previous, FK_STORE_BUILT_IN};
    int32_t error = FK_OK;
    for (uint32_t i = 0u; i < 3u; ++i) {
        error = check_table(store, tables[i]);
        if (error == FK_OK) {
            use_table(store, tables[i]);
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
    return append(store, &store->update);
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
    if (store->next_offset % FK_FLASH_PAGE_BYTES == 0u && erase_page(store, at) != FK_STATUS_OK) {
        return FK_STATUS_FLASH;
    }
    if (program(store, at, words, count / 4u) != FK_STATUS_OK) {
        return FK_STATUS_FLASH;
    }
    store->next_offset += count;
    if (store->next_offset % FK_FLASH_PAGE_BYTES == 0u) {
        fk_store_record_t next = store->record;
        next.pages_done = (uint8_t)(store->next_offset / FK_FLASH_PAGE_BYTES);
        return append(store, &next);
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
        (void)append(store, &next); /* the upload cannot be continued; if this fails too, the table stays unused */
        return status;
    }
    next.previous = store->running;
    next.active = slot;
    if (append(store, &next) != FK_STATUS_OK) {
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
    if (append(store, &next) != FK_STATUS_OK) {
        return FK_STATUS_FLASH;
    }
    use_table(store, table);
    return FK_STATUS_OK;
}
