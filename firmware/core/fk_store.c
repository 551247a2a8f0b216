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
    return fk_crc32(0u, (const uint8_t *)words->words, FK_STORE_RECORD_BYTES - 4u) ^ FK_STORE_MAGIC;
}

static uint32_t step_offset(uint32_t page, uint32_t place)
{
    return page * FK_FLASH_PAGE_BYTES + place * FK_STORE_STEP_BYTES;
}

static uint32_t superseded_offset(uint32_t page) { return page * FK_FLASH_PAGE_BYTES + FK_STORE_SUPERSEDED_AT; }

static int32_t read_copy(const fk_store_t *store, uint32_t offset, fk_store_words_t *words)
{
    for (uint32_t i = 0u; i < FK_STORE_RECORD_WORDS; ++i) {
        words->words[i] = word_at(store, offset + 4u * i);
    }
    return words->record.check == check_of(words);
}

/* What a place of the journal holds. From IN_DOUBT on there is a valid record. */
typedef enum {
    EMPTY,    /* never written */
    TORN,     /* begun, and never told as done */
    DAMAGED,  /* done, and both copies are spoilt */
    IN_DOUBT, /* a copy or the mark is missing */
    WHOLE
} step_t;

static step_t read_step(const fk_store_t *store, uint32_t offset, fk_store_words_t *words)
{
    const uint32_t is_committed = word_at(store, offset + FK_STORE_MARK_AT) == FK_STORE_COMMITTED;
    uint32_t empty = 0u;
    while (empty < FK_STORE_STEP_BYTES && word_at(store, offset + empty) == UINT32_MAX) {
        empty += 4u;
    }
    if (empty == FK_STORE_STEP_BYTES) {
        return EMPTY;
    }
    if (read_copy(store, offset, words)) {
        uint32_t differing = 0u;
        for (uint32_t i = 0u; i < FK_STORE_RECORD_WORDS; ++i) {
            differing |= words->words[i] ^ word_at(store, offset + FK_STORE_RECORD_BYTES + 4u * i);
        }
        return (is_committed && differing == 0u) ? WHOLE : IN_DOUBT;
    }
    if (read_copy(store, offset + FK_STORE_RECORD_BYTES, words)) {
        return IN_DOUBT;
    }
    return is_committed ? DAMAGED : TORN;
}

/* Of another layout of slots: the tables are not where this firmware looks for them, but the robot keeps its owner. */
static void forget_tables(fk_store_record_t *record)
{
    record->active = FK_STORE_BUILT_IN;
    record->previous = FK_STORE_BUILT_IN;
    record->pending = 0u;
    for (uint32_t i = 0u; i < FK_STORE_SLOTS_MAX; ++i) {
        record->length[i] = 0u;
        record->crc32[i] = 0u;
    }
}

/* Find the newest valid record and the place for the next step. */
static void read_journal(fk_store_t *store)
{
    static const fk_store_words_t nothing = {.words = {0u}};
    fk_store_words_t words;
    store->record = nothing.record;
    store->sequence = 0u;
    store->newest_page = FK_STORE_JOURNAL_PAGES - 1u; /* without any record the first goes to page 0, erased */
    store->page = store->newest_page;
    store->place = FK_STORE_STEPS;
    store->in_doubt = 0u;
    store->lost = 0u;
    for (uint32_t page = 0u; page < FK_STORE_JOURNAL_PAGES; ++page) {
        for (uint32_t place = 0u; place < FK_STORE_STEPS; ++place) {
            const step_t step = read_step(store, step_offset(page, place), &words);
            if (step >= IN_DOUBT && words.record.sequence > store->record.sequence) {
                store->record = words.record;
                store->sequence = words.record.sequence;
                store->newest_page = page;
                store->page = page;
                store->place = place + 1u;
                store->in_doubt = (step != WHOLE) ? 1u : 0u;
                store->lost = 0u;
            } else if ((step == TORN || step == DAMAGED) && (store->record.sequence == 0u || store->page == page)) {
                if (store->record.sequence != 0u) {
                    /* Behind the newest one. Its bits may be marginal and read as a valid record at another boot, so
                     * its sequence number and its place are used up. */
                    store->sequence += place + 1u - store->place;
                    store->place = place + 1u;
                }
                store->in_doubt = 1u;
                store->lost |= (step == DAMAGED) ? 1u : 0u;
            }
        }
    }
    for (uint32_t page = 0u; page < FK_STORE_JOURNAL_PAGES; ++page) {
        if ((page == store->newest_page || store->record.sequence == 0u) &&
            word_at(store, superseded_offset(page)) == FK_STORE_SUPERSEDED) {
            store->lost = 1u;
        }
    }
    if (store->place >= FK_STORE_STEPS && store->record.sequence != 0u) {
        /* The next step goes to the other page, and may have been begun there. */
        const step_t step = read_step(store, step_offset(FK_STORE_JOURNAL_PAGES - 1u - store->newest_page, 0u), &words);
        store->in_doubt |= (step == TORN || step == DAMAGED) ? 1u : 0u;
    }
    if (store->record.layout != layout_of(store->flash)) {
        forget_tables(&store->record);
    }
}

/* Write a step. It has happened when one of its copies is written, and not before.
 * @retval FK_STATUS_FLASH  neither copy holds
 */
static int8_t write_step(fk_store_t *store, const fk_store_record_t *next)
{
    fk_store_words_t words;
    words.record = *next;
    if (store->place >= FK_STORE_STEPS) {
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
    const uint32_t offset = step_offset(store->page, store->place);
    ++store->place;
    ++store->sequence;
    words.record.layout = layout_of(store->flash);
    words.record.sequence = store->sequence;
    words.record.check = check_of(&words);
    store->in_doubt = 1u;
    uint32_t held = 0u;
    for (uint32_t copy = 0u; copy < FK_STORE_COPIES; ++copy) {
        const uint32_t at = offset + copy * FK_STORE_RECORD_BYTES;
        held += (program(store, at, words.words, FK_STORE_RECORD_WORDS) == FK_STATUS_OK) ? 1u : 0u;
    }
    if (held == 0u) {
        return FK_STATUS_FLASH;
    }
    store->record = words.record;
    store->newest_page = store->page;
    if (held == FK_STORE_COPIES) {
        static const uint32_t superseded = FK_STORE_SUPERSEDED;
        static const uint32_t committed = FK_STORE_COMMITTED;
        const uint32_t other = superseded_offset(FK_STORE_JOURNAL_PAGES - 1u - store->page);
        if (word_at(store, other) == UINT32_MAX) {
            (void)program(store, other, &superseded, 1u); /* without it the page's loss would not show, and that is all */
        }
        store->in_doubt = (program(store, offset + FK_STORE_MARK_AT, &committed, 1u) == FK_STATUS_OK) ? 0u : 1u;
    }
    return FK_STATUS_OK;
}

/* Append a step, and where the flash does not hold all of it, what is true now once more. */
static int8_t append(fk_store_t *store, const fk_store_record_t *next)
{
    if (store->lost != 0u) {
        return FK_STATUS_FLASH;
    }
    const int8_t status = write_step(store, next);
    if (store->in_doubt != 0u) {
        (void)write_step(store, &store->record);
    }
    return status;
}

int8_t fk_store_own(fk_store_t *store, const uint32_t key[FK_STORE_KEY_WORDS])
{
    fk_store_record_t next = store->record;
    uint32_t differing = 0u;
    for (uint32_t i = 0u; i < FK_STORE_KEY_WORDS; ++i) {
        differing |= key[i] ^ next.owner_key[i];
        next.owner_key[i] = key[i];
    }
    return (differing == 0u && store->lost == 0u) ? (int8_t)FK_STATUS_OK : append(store, &next);
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
    read_journal(store);
    if (store->in_doubt != 0u) {
        fk_store_record_t next = store->record;
        ++next.repairs;
        (void)append(store, &next); /* a flash that does not hold it is in doubt again at the next boot */
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
