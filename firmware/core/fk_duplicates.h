/* Which commands were had before: a radio delivers frames twice, and a host that missed an answer asks again. Such a
 * command acts once, and is answered as it was. DISARM and STOP are none of these: they act whenever they come.
 *
 * A frame is a repetition where its sequence number and its CRC-32 (over type, sequence and payload) are those of one
 * that is kept. Kept are the last FK_DUPLICATES_KEPT commands that matter, each for the next FK_DUPLICATES_SPAN sequence
 * numbers: after these the host may use the number again.
 */
#ifndef FK_DUPLICATES_H
#define FK_DUPLICATES_H

#include <stdint.h>

#include "fk_frames.h"

#define FK_DUPLICATES_KEPT 32u
#define FK_DUPLICATES_SPAN 127u
#define FK_DUPLICATES_ANSWER_BYTES 12u

/* The longest answers of commands that are kept. */
typedef char fk_start_answer_is_kept[(FK_START_ANSWER_BYTES <= FK_DUPLICATES_ANSWER_BYTES) ? 1 : -1];
typedef char fk_stroke_answer_is_kept[(FK_STROKE_ANSWER_BYTES <= FK_DUPLICATES_ANSWER_BYTES) ? 1 : -1];

typedef char fk_table_answer_is_kept[(FK_TABLE_BEGIN_ANSWER_BYTES <= FK_DUPLICATES_ANSWER_BYTES) ? 1 : -1];

typedef struct {
    uint32_t crc;
    uint8_t sequence;
    uint8_t age;    /* sequence numbers that have come since; above FK_DUPLICATES_SPAN: not kept */
    uint8_t length; /* of the answer's payload */
    uint8_t answer[FK_DUPLICATES_ANSWER_BYTES];
} fk_duplicate_t;

typedef struct {
    fk_duplicate_t kept[FK_DUPLICATES_KEPT];
    uint32_t next; /* place of the next one, also the oldest */
    uint8_t newest; /* sequence number furthest on */
} fk_duplicates_t;

/* Nothing is a repetition: a conversation begins. */
void fk_duplicates_init(fk_duplicates_t *duplicates);

/* A frame has come, of any type: the numbers of those before it are that much older. */
void fk_duplicates_note(fk_duplicates_t *duplicates, uint8_t sequence);

/* The kept command that this frame duplicates, or 0. */
const fk_duplicate_t *fk_duplicates_find(const fk_duplicates_t *duplicates, const fk_frame_t *frame);

/* Keep a command and its answer, 1 to FK_DUPLICATES_ANSWER_BYTES bytes. */
void fk_duplicates_keep(fk_duplicates_t *duplicates, const fk_frame_t *frame, const uint8_t *answer, uint32_t length);

#endif
