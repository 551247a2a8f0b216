/* Duplicate filter for commands: a radio may deliver a frame twice, and a host that missed an answer sends the
 * command again. A repeated command does not act again, and gets the answer that the first one got. DISARM and STOP
 * are not filtered.
 *
 * A frame repeats a command if its sequence number and its CRC-32 (over type, sequence and payload) are those of one
 * that is kept. Of the newest FK_DUPLICATES_KEPT sequence numbers those are kept whose commands change something; the
 * answers only of the last FK_DUPLICATES_ANSWERS or so, because no host waits for an older one. A number up to
 * FK_DUPLICATES_KEPT - 1 before the newest is late. Any other one is ahead, as after up to 192 frames that were lost, and
 * what it leaves too far behind is forgotten.
 *
 * HELLO tells a host the newest number, from which it counts on: so hosts that follow each other do not use the same
 * numbers, and no HELLO need forget anything. FIX has numbers of its own, which are not looked at: a camera would use all
 * of them up within seconds. A command with an authentication code differs from every other by its code, so only the
 * owner's frames count where the robot has an owner.
 */
#ifndef FK_DUPLICATES_H
#define FK_DUPLICATES_H

#include <stdint.h>

#include "fk_frames.h"

#define FK_DUPLICATES_KEPT 64u    /* a power of two */
#define FK_DUPLICATES_ANSWERS 16u /* a power of two; a host has at most 4 commands under way */
#define FK_DUPLICATES_ANSWER_BYTES 12u

/* All are forgotten when nothing has been heard for so long. A host that loses more frames than can be told from late
 * ones gives each four of them up after 2 s, so that it is silent for longer. */
#define FK_DUPLICATES_SILENT_US 80000000u

/* The longest answers of commands that are kept. */
typedef char fk_start_answer_is_kept[(FK_START_ANSWER_BYTES <= FK_DUPLICATES_ANSWER_BYTES) ? 1 : -1];
typedef char fk_stroke_answer_is_kept[(FK_STROKE_ANSWER_BYTES <= FK_DUPLICATES_ANSWER_BYTES) ? 1 : -1];

typedef char fk_table_answer_is_kept[(FK_TABLE_BEGIN_ANSWER_BYTES <= FK_DUPLICATES_ANSWER_BYTES) ? 1 : -1];

typedef struct {
    uint8_t sequence; /* whose answer it is */
    uint8_t length;   /* of its payload */
    uint8_t bytes[FK_DUPLICATES_ANSWER_BYTES];
} fk_kept_answer_t;

typedef struct {
    /* By sequence number, modulo the size of each. CRC 0: nothing is kept there. */
    uint32_t crc[FK_DUPLICATES_KEPT];
    fk_kept_answer_t answers[FK_DUPLICATES_ANSWERS];
    uint8_t newest; /* most advanced sequence number */
} fk_duplicates_t;

void fk_duplicates_init(fk_duplicates_t *duplicates);

/* Forget all commands; the newest number stays. */
void fk_duplicates_forget(fk_duplicates_t *duplicates);

/* The answer to the kept command that this frame repeats, or 0. Status DOUBLE stands for an answer that is not kept. */
const fk_kept_answer_t *fk_duplicates_find(const fk_duplicates_t *duplicates, const fk_frame_t *frame);

/* A frame that counts has arrived: what lies too far behind its number is forgotten. */
void fk_duplicates_note(fk_duplicates_t *duplicates, uint8_t sequence);

/* Keep a command whose number was noted, and its answer, 1 to FK_DUPLICATES_ANSWER_BYTES bytes. */
void fk_duplicates_keep(fk_duplicates_t *duplicates, const fk_frame_t *frame, const uint8_t *answer, uint32_t length);

#endif
