/* The journal of the store, and writing to flash. */
#include "fk_journal.h"

#include "fk_frames_layout.h"
#include "fk_planner.h"

typedef union {
    fk_store_record_t record;
    uint32_t words[FK_STORE_RECORD_WORDS];
} fk_store_words_t;

uint32_t fk_journal_word(const fk_store_t *store, uint32_t offset) { return fk_get_u32(store->flash->base + offset); }

static uint32_t layout_of(const fk_flash_t *flash) { return flash->slot_bytes + flash->slots; }

int8_t fk_journal_erase(const fk_store_t *store, uint32_t offset)
{
    fk_flash_erase(store->flash, offset);
    for (uint32_t at = 0u; at < FK_FLASH_PAGE_BYTES; at += 4u) {
        if (fk_journal_word(store, offset + at) != UINT32_MAX) {
            return FK_STATUS_FLASH;
        }
    }
    return FK_STATUS_OK;
}

int8_t fk_journal_program(const fk_store_t *store, uint32_t offset, const uint32_t *words, uint32_t count)
{
    fk_flash_program(store->flash, offset, words, count);
    for (uint32_t i = 0u; i < count; ++i) {
        if (fk_journal_word(store, offset + 4u * i) != words[i]) {
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
        words->words[i] = fk_journal_word(store, offset + 4u * i);
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
    const uint32_t is_committed = fk_journal_word(store, offset + FK_STORE_MARK_AT) == FK_STORE_COMMITTED;
    uint32_t empty = 0u;
    while (empty < FK_STORE_STEP_BYTES && fk_journal_word(store, offset + empty) == UINT32_MAX) {
        empty += 4u;
    }
    if (empty == FK_STORE_STEP_BYTES) {
        return EMPTY;
    }
    if (read_copy(store, offset, words)) {
        uint32_t differing = 0u;
        for (uint32_t i = 0u; i < FK_STORE_RECORD_WORDS; ++i) {
            differing |= words->words[i] ^ fk_journal_word(store, offset + FK_STORE_RECORD_BYTES + 4u * i);
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

void fk_journal_read(fk_store_t *store)
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
            fk_journal_word(store, superseded_offset(page)) == FK_STORE_SUPERSEDED) {
            store->lost = 1u;
        }
    }
    if (store->place >= FK_STORE_STEPS && store->record.sequence != 0u) {
        /* The next step goes to the other page, and may have been begun there, once that was erased. */
        const uint32_t other = FK_STORE_JOURNAL_PAGES - 1u - store->newest_page;
        const step_t step = read_step(store, step_offset(other, 0u), &words);
        if ((step == TORN || step == DAMAGED) && read_step(store, step_offset(other, 1u), &words) == EMPTY) {
            store->in_doubt = 1u;
        }
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
        if (fk_journal_erase(store, page * FK_FLASH_PAGE_BYTES) != FK_STATUS_OK) {
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
        held += (fk_journal_program(store, at, words.words, FK_STORE_RECORD_WORDS) == FK_STATUS_OK) ? 1u : 0u;
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
        if (fk_journal_word(store, other) == UINT32_MAX) {
            (void)fk_journal_program(store, other, &superseded, 1u); /* where it does not hold, a lost page does not show */
        }
        const int8_t status = fk_journal_program(store, offset + FK_STORE_MARK_AT, &committed, 1u);
        store->in_doubt = (status != FK_STATUS_OK) ? 1u : 0u;
    }
    return FK_STATUS_OK;
}

int8_t fk_journal_append(fk_store_t *store, const fk_store_record_t *next)
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
