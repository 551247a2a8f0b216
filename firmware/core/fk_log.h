/* The robot's log: a ring buffer of records in RAM, in which whole records overwrite the oldest ones. A host fetches
 * it with LOG and can replay every decision from it. frames.toml defines the records;
 * host/docs/pages/reference/link.md lists them.
 *
 * A record: length u8 of its content, id u8, checksum u16, time 48 bit (us, the robot's clock), content. The checksum
 * is Fletcher's (Fletcher 1982), modulo 256, over all but itself: it finds every single wrong bit, and is cheap.
 *
 * An offset counts all bytes ever written, modulo 2^32, so a record keeps its offset while the ring goes round. In
 * RAM that no start-up code clears the log survives a reset, but for one within the few instructions that drop the
 * oldest record or finish one: the log is not whole then, and begins empty. After a loss of supply that RAM holds
 * something else, which the checksums show.
 */
#ifndef FK_LOG_H
#define FK_LOG_H

#include <stdint.h>

#include "fk_frames_layout.h"

#ifndef FK_LOG_BYTES
#define FK_LOG_BYTES 24576u /* of a run with 15 fixes a second 15 s at least, from a snapshot on */
#endif

#define FK_LOG_HEAD_BYTES 10u
#define FK_LOG_CONTENT_MAX 255u
#define FK_LOG_SNAPSHOT_EVERY_BYTES 3584u /* of other records between snapshots; a host that replays the log has the same */
#define FK_LOG_SNAPSHOT_MAX_BYTES 5888u   /* all records of one snapshot, with their heads: fk_snapshot.c */
#define FK_LOG_WAITING_BYTES 1408u        /* of records while a snapshot that is due waits for the pulses of a stroke */

/* So that the log of an armed robot always holds a whole snapshot, unless a host sends more than that while it waits. */
typedef char fk_log_holds_a_snapshot[(FK_LOG_BYTES >= FK_LOG_SNAPSHOT_MAX_BYTES + FK_LOG_SNAPSHOT_EVERY_BYTES +
                                                          FK_LOG_WAITING_BYTES &&
                                      FK_LOG_BYTES <= 0x40000000u)
                                         ? 1
                                         : -1];

typedef struct {
    uint32_t magic;
    uint32_t begin; /* offset of the oldest record */
    uint32_t end;   /* offset behind the newest record */
    uint32_t first; /* index in bytes[] of the oldest record */
    uint32_t lost;  /* records that were overwritten */
    uint8_t bytes[FK_LOG_BYTES];
} fk_log_t;

/* Continue the log that is there if all of its records are sound; else begin an empty one.
 * @retval 1  continued
 * @retval 0  empty
 */
int32_t fk_log_open(fk_log_t *log);

/* Add a record; the oldest ones are dropped as far as it needs their room.
 * @param content  of 0 to FK_LOG_CONTENT_MAX bytes
 * @retval  its offset
 */
uint32_t fk_log_write(fk_log_t *log, uint8_t id, uint64_t time_us, const uint8_t *content, uint32_t length);

/* Change the last byte of a record.
 * @param offset  of that record, which has content and is still there
 */
void fk_log_finish(fk_log_t *log, uint32_t offset, uint8_t last);

/* Copy bytes from an offset on, or from the oldest record on if the offset is no longer in the log, or not yet.
 * @param from  offset of the first byte copied
 * @retval  bytes copied, 0 to capacity
 */
uint32_t fk_log_read(const fk_log_t *log, uint32_t offset, uint8_t *bytes, uint32_t capacity, uint32_t *from);

#endif
