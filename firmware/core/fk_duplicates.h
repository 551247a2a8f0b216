/* Duplicate filter for commands: a radio may deliver a frame twice, and a host that missed an answer sends the
 * command again. A repeated command does not act again, and gets the answer that the first one got. DISARM and STOP
 * are not filtered.
 *
 * A frame repeats a command if its sequence number and its CRC-32 (over type, sequence and payload) are those of one
 * that is kept. The last FK_DUPLICATES_KEPT commands that change something are kept, each for the next
 * FK_DUPLICATES_SPAN sequence numbers; after these the host may use the number again. A frame that is later than that
 * cannot be told from one as far ahead: it acts, and all that were kept are forgotten. Chunks of a table, of which there are
 * hundreds, have places of their own: an ARM that comes again behind them must still be known.
 */
#ifndef FK_DUPLICATES_H
#define FK_DUPLICATES_H

#include <stdint.h>

#include "fk_frames.h"

#define FK_DUPLICATES_KEPT 32u
#define FK_DUPLICATES_CHUNKS 8u /* a host has at most 4 of them under way */
#define FK_DUPLICATES_SPAN 127u
#define FK_DUPLICATES_ANSWER_BYTES 12u

/* The longest answers of commands that are kept. */
typedef char fk_start_answer_is_kept[(FK_START_ANSWER_BYTES <= FK_DUPLICATES_ANSWER_BYTES) ? 1 : -1];
typedef char fk_stroke_answer_is_kept[(FK_STROKE_ANSWER_BYTES <= FK_DUPLICATES_ANSWER_BYTES) ? 1 : -1];

typedef char fk_table_answer_is_kept[(FK_TABLE_BEGIN_ANSWER_BYTES <= FK_DUPLICATES_ANSWER_BYTES) ? 1 : -1];

typedef struct {
    uint32_t crc;
    uint8_t sequence;
    uint8_t age;    /* by how many sequence numbers later frames are ahead; above FK_DUPLICATES_SPAN: not kept */
    uint8_t length; /* of the answer's payload */
    uint8_t answer[FK_DUPLICATES_ANSWER_BYTES];
} fk_duplicate_t;

typedef struct {
    fk_duplicate_t kept[FK_DUPLICATES_KEPT + FK_DUPLICATES_CHUNKS]; /* chunks of a table behind all others */
    uint32_t next;       /* entry of the next one, which is also the oldest */
    uint32_t next_chunk; /* the same of the next chunk */
    uint8_t newest; /* most advanced sequence number */
} fk_duplicates_t;

/* Forget all commands: a conversation begins. */
void fk_duplicates_init(fk_duplicates_t *duplicates);

/* A frame of any type has arrived: the kept commands age by as many numbers as it is ahead of the newest. */
void fk_duplicates_note(fk_duplicates_t *duplicates, uint8_t sequence);

/* The kept command that this frame repeats, or 0. */
const fk_duplicate_t *fk_duplicates_find(const fk_duplicates_t *duplicates, const fk_frame_t *frame);

/* Keep a command and its answer, 1 to FK_DUPLICATES_ANSWER_BYTES bytes. */
void fk_duplicates_keep(fk_duplicates_t *duplicates, const fk_frame_t *frame, const uint8_t *answer, uint32_t length);

#endif
