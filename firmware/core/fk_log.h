/* What the robot lived through, in RAM: records one behind the other in a ring, the oldest overwritten, whole ones only.
 * A host fetches them with LOG and decides everything again from them; which records there are and what stands in them
 * says frames.toml, of which the documentation has the table: host/docs/pages/reference/link.md.
 *
 * A record: length u8 of its content, id u8, check u16, time 48 bit (us, the robot's clock), content. The check is that
 * of Fletcher, modulo 256, over all but itself: it finds every single wrong bit, and costs little.
 *
 * Offsets count all bytes ever written, modulo 2^32: what has been fetched keeps its offset while the ring goes round.
 * In RAM that no start-up clears it outlives a reset; after a time without supply that RAM holds something else, which
 * the checks tell.
 */
#ifndef FK_LOG_H
#define FK_LOG_H

#include <stdint.h>

#include "fk_frames_layout.h"

#ifndef FK_LOG_BYTES
#define FK_LOG_BYTES 24576u /* half a minute of a run with 15 fixes a second, and a snapshot to begin from */
#endif

#define FK_LOG_HEAD_BYTES 10u
#define FK_LOG_CONTENT_MAX 255u
#define FK_LOG_SNAPSHOT_EVERY_BYTES 6144u /* of other records; a host that replays the log must have the same */
#define FK_LOG_SNAPSHOT_MAX_BYTES 4096u   /* with its heads */

/* So there is always a whole snapshot in it. */
typedef char fk_log_holds_two_snapshots[(FK_LOG_BYTES >= FK_LOG_SNAPSHOT_EVERY_BYTES + 2u * FK_LOG_SNAPSHOT_MAX_BYTES &&
                                         FK_LOG_BYTES <= 0x40000000u)
                                            ? 1
                                            : -1];

typedef struct {
    uint32_t magic;
    uint32_t begin; /* offset of the oldest record */
    uint32_t end;   /* behind the newest one */
    uint32_t first; /* place of the oldest record in bytes */
    uint32_t lost;  /* records overwritten */
    uint8_t bytes[FK_LOG_BYTES];
} fk_log_t;

/* Go on with what is there, if all of it is whole; else begin empty.
 * @retval 1  goes on
 * @retval 0  empty
 */
int32_t fk_log_open(fk_log_t *log);

/* Add a record; what has no room beside it goes, from the oldest on.
 * @param content  of 0 to FK_LOG_CONTENT_MAX bytes
 * @retval  its offset
 */
uint32_t fk_log_write(fk_log_t *log, uint8_t id, uint64_t time_us, const uint8_t *content, uint32_t length);

/* Change the last byte of a record.
 * @param offset  of that record, which has content and is still there
 */
void fk_log_finish(fk_log_t *log, uint32_t offset, uint8_t last);

/* Copy what is there from an offset on; from the oldest record on where that place is there no longer, or not yet.
 * @param from  offset of the first byte copied
 * @retval  bytes copied, 0 to capacity
 */
uint32_t fk_log_read(const fk_log_t *log, uint32_t offset, uint8_t *bytes, uint32_t capacity, uint32_t *from);

#endif
