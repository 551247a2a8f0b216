/* The journal of the store (fk_store.h says how it is laid out and why), for fk_store.c alone. */
#ifndef FK_JOURNAL_H
#define FK_JOURNAL_H

#include "fk_store.h"

/* Find the newest valid record and the place for the next step, and whether what was found is in doubt or lost. Writes
 * nothing. */
void fk_journal_read(fk_store_t *store);

/* Append a step, and where the flash does not hold all of it, what is true now once more.
 * @param next  may be store->record
 * @retval FK_STATUS_OK     it has happened: a copy of its record is written
 * @retval FK_STATUS_FLASH  the flash holds no copy, or the store is lost; nothing changed
 */
int8_t fk_journal_append(fk_store_t *store, const fk_store_record_t *next);

/* Of any part of the region: read a word; erase the page that begins at offset; write words. The last two read back.
 * @retval FK_STATUS_OK
 * @retval FK_STATUS_FLASH  the flash does not hold it
 */
uint32_t fk_journal_word(const fk_store_t *store, uint32_t offset);
int8_t fk_journal_erase(const fk_store_t *store, uint32_t offset);
int8_t fk_journal_program(const fk_store_t *store, uint32_t offset, const uint32_t *words, uint32_t count);

#endif
