/* The table store: tables in flash, one in use and one beside it that an update fills. A power cut at any moment
 * leaves the whole old table or the whole new one in use.
 *
 * The flash region holds two journal pages, then one or two slots of whole pages:
 *
 *   | journal 0 | journal 1 | slot 1 ... | slot 2 ... |        table 0 is the one built into the firmware
 *
 * The journal is a sequence of steps. A step is one record, written twice, and behind its two copies a mark:
 *
 *   | step 0: copy, copy, COMMITTED | step 1: ... | ... | SUPERSEDED |       a journal page
 *
 * A record holds the store's whole state with a sequence number; a copy is valid only with a correct CRC-32, and is never
 * changed. The newest step with a valid copy counts: begin, each page that is done, commit, rollback, a key. A step goes
 * to the next place that was never written. Behind the last place the other page is erased, which holds only older
 * steps, and the journal continues there. The first step there marks the page that it leaves as SUPERSEDED.
 *
 * The state that a boot has found is the state of every later boot, until a command changes it:
 *
 * - A step happens when one of its copies is written, and a power cut leaves at most one word whose bits may read
 *   otherwise at each boot. COMMITTED is written when both copies have been read back. So a step that has its mark and
 *   two equal copies stands firm. Whatever else is newest, or was begun behind that, is in doubt: boot writes the state
 *   that it has read as a new step, before anybody is answered.
 * - One wrong bit spoils one copy, or one mark, and the other copy holds the state. Boot writes both anew.
 * - Where both copies of a step are spoilt that has its mark, or the newest page is, the state is lost: what is left is
 *   older, and its key may be one that was taken away. Such a store is owned, by nobody, and writes nothing more; the
 *   robot is in FAULT until its chip is erased. A step without its mark was cut short, and never told as done.
 *
 * A slot is erased and written only while it is neither in use nor the target of a rollback, and a record says so
 * first. That record is written just before the first page is erased, so that beginning an update wears nothing. A
 * table in a slot is used only after a COMMIT has read all of it back (hash, CRC-32, format, every index, robot,
 * limits) and its record is valid; at boot it is checked again.
 */
#ifndef FK_STORE_H
#define FK_STORE_H

#include <stdint.h>

#include "fk_sha256.h"

#define FK_FLASH_PAGE_BYTES 4096u
#define FK_FLASH_ERASES_MAX 10000u /* erases that a page endures */
#define FK_STORE_CHUNK_BYTES 128u  /* of an upload; a page is whole chunks */
#define FK_STORE_JOURNAL_PAGES 2u
#define FK_STORE_SLOTS_MAX 2u
#define FK_STORE_BUILT_IN 0u       /* the table of the firmware itself; slots count from 1 */
#define FK_STORE_KEY_WORDS 8u

/* The region, given by the port. */
typedef struct {
    const uint8_t *base; /* where it can be read, on 4 bytes */
    uint32_t slot_bytes; /* whole pages */
    uint32_t slots;      /* 1 or 2 */
    void *context;       /* the port's own */
} fk_flash_t;

/* What the port implements: named functions instead of pointers, so that the stack analysis can follow them.
 * Neither reports success, as the store reads back what it wrote. Both return when the flash is done. */

/* Erase the page that begins at offset. */
void fk_flash_erase(const fk_flash_t *flash, uint32_t offset);

/* Write words from offset on, in this order, each one once after its page was erased. */
void fk_flash_program(const fk_flash_t *flash, uint32_t offset, const uint32_t *words, uint32_t count);

/* A record of the journal, as it lies in flash. */
typedef struct {
    uint32_t layout;                        /* slot_bytes + slots: of a record of another layout the key alone holds */
    uint32_t sequence;                      /* the larger, the newer */
    uint8_t active;                         /* table in use: FK_STORE_BUILT_IN, 1 or 2 */
    uint8_t previous;                       /* the table before that, likewise */
    uint8_t pending;                        /* slot that an update writes, 0: none */
    uint8_t pages_done;                     /* whole pages of the update that have been written */
    uint32_t length[FK_STORE_SLOTS_MAX];    /* of the image in each slot, 0: none */
    uint32_t crc32[FK_STORE_SLOTS_MAX];     /* as in that image's header, from its COMMIT on */
    uint16_t erases[FK_STORE_SLOTS_MAX];    /* of a slot's pages, at most: uploads that wrote there */
    uint32_t journal_erases;                /* of both pages together */
    uint32_t repairs;                       /* boots that wrote the newest step anew, as it was in doubt */
    uint32_t hash[FK_SHA256_WORDS];         /* SHA-256 of the image that was begun last */
    uint32_t owner_key[FK_STORE_KEY_WORDS]; /* little-endian words; all zero: none */
    uint32_t check;                         /* CRC-32 of all before it, exclusive or FK_STORE_MAGIC */
} fk_store_record_t;

#define FK_STORE_MAGIC 0x33534B46u      /* "FKS3": of this version of the journal */
#define FK_STORE_COMMITTED 0x454E4F44u  /* "DONE": both copies of the step have been read back */
#define FK_STORE_SUPERSEDED 0x54584E4Eu /* "NNXT": the other page has a newer step */
#define FK_STORE_RECORD_WORDS 27u
#define FK_STORE_RECORD_BYTES (4u * FK_STORE_RECORD_WORDS)
#define FK_STORE_COPIES 2u
#define FK_STORE_MARK_AT (FK_STORE_COPIES * FK_STORE_RECORD_BYTES) /* in a step */
#define FK_STORE_STEP_BYTES (FK_STORE_MARK_AT + 4u)
#define FK_STORE_SUPERSEDED_AT (FK_FLASH_PAGE_BYTES - 4u) /* in a journal page */
#define FK_STORE_STEPS (FK_STORE_SUPERSEDED_AT / FK_STORE_STEP_BYTES) /* places of a journal page */

typedef char fk_store_record_is_whole[(sizeof(fk_store_record_t) == FK_STORE_RECORD_BYTES) ? 1 : -1];

typedef struct {
    const fk_flash_t *flash;
    const uint8_t *built_in;
    uint32_t built_in_bytes;
    const uint8_t *image;     /* the table in use */
    uint32_t image_bytes;
    uint8_t running;          /* its number; differs from record.active where that table failed its check at boot */
    uint8_t open;             /* 1: an update accepts chunks */
    uint8_t begun;            /* 1: the open update's record is written, so its pages may be erased */
    uint32_t next_offset;     /* of the next chunk wanted */
    fk_store_record_t record; /* the newest one */
    fk_store_record_t update; /* the open update's, until it is written before the first page is erased */
    uint8_t in_doubt;         /* 1: the newest step is not whole, or another one was begun behind it */
    uint8_t lost;             /* 1: what was stored last cannot be read, and nothing is written any more */
    uint32_t sequence;        /* of the newest step, valid or not */
    uint32_t newest_page;     /* journal page of the newest valid step */
    uint32_t page;            /* journal page of the next step */
    uint32_t place;           /* its place there; FK_STORE_STEPS: the page is full, and it goes to the other one */
} fk_store_t;

/* Find a table that passes its check: the one in use, else the one before it, else the built-in one. Writes only where
 * what it has read is in doubt: that as a new step, so that the next boot reads the same. store->lost tells that the
 * owner's key cannot be read.
 * @param flash     stays valid as long as the store lives, like built_in
 * @retval 0         store->image is ready
 * @retval negative  fk_error_t: not even the built-in table passes, which store->image is all the same
 */
int32_t fk_store_boot(fk_store_t *store, const fk_flash_t *flash, const uint8_t *built_in, uint32_t built_in_bytes);

/* Begin an update, or continue one of the same length and hash at store->next_offset. Writes nothing.
 * @param length  bytes of the image, whole words
 * @retval FK_STATUS_OK
 * @retval FK_STATUS_VALUE  not the length of a table, or more than a slot holds
 * @retval FK_STATUS_SLOT   the only slot holds the table in use: go back to the built-in one first
 * @retval FK_STATUS_WORN   each slot that is free has been erased FK_FLASH_ERASES_MAX times
 */
int8_t fk_store_begin(fk_store_t *store, uint32_t length, const uint32_t hash[FK_SHA256_WORDS]);

/* Write the next chunk: FK_STORE_CHUNK_BYTES, or what is left.
 * @retval FK_STATUS_OK
 * @retval FK_STATUS_STATE   no update is open
 * @retval FK_STATUS_OFFSET  not store->next_offset; nothing was written
 * @retval FK_STATUS_LENGTH  not FK_STORE_CHUNK_BYTES, or what is left; nothing was written
 * @retval FK_STATUS_FLASH   the flash does not hold what was written; the update is closed
 */
int8_t fk_store_chunk(fk_store_t *store, uint32_t offset, const uint8_t *bytes, uint32_t count);

/* Check the whole image and put it in use, by one record. The update is closed either way.
 * @param error  fk_error_t of FK_STATUS_TABLE
 * @retval FK_STATUS_OK
 * @retval FK_STATUS_STATE  no update is open, or chunks are missing; nothing changed
 * @retval FK_STATUS_HASH   another image than was announced
 * @retval FK_STATUS_TABLE  not a table, or not for this robot
 * @retval FK_STATUS_FLASH  the flash does not hold what was written
 */
int8_t fk_store_commit(fk_store_t *store, int8_t *error);

/* Use a table that is stored here, by one record: the previous or the built-in one. An open update is closed. Nothing
 * else happens where the table is in use already, so that a repeated request changes nothing.
 * @param crc32  as in the table's header
 * @param error  fk_error_t of FK_STATUS_TABLE
 * @retval FK_STATUS_OK
 * @retval FK_STATUS_VALUE  neither table has this CRC-32
 * @retval FK_STATUS_TABLE  the table is damaged
 * @retval FK_STATUS_FLASH  the flash does not hold what was written
 */
int8_t fk_store_rollback(fk_store_t *store, uint32_t crc32, int8_t *error);

/* Store an owner's key, by one record; eight zeros remove it. No update may be open.
 * @retval FK_STATUS_OK     it is stored, or was already, and then nothing is written
 * @retval FK_STATUS_FLASH  the flash does not hold what was written
 */
int8_t fk_store_own(fk_store_t *store, const uint32_t key[FK_STORE_KEY_WORDS]);

/* Whether there is an owner's key, or was one that may be lost. */
int32_t fk_store_is_owned(const fk_store_t *store);

/* CRC-32 in the header of a table: FK_STORE_BUILT_IN, or a slot that was committed. */
uint32_t fk_store_crc32(const fk_store_t *store, uint8_t table);

#endif
