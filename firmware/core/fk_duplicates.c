#include "fk_duplicates.h"

#define NUMBERS 256u

static uint32_t place_of(uint32_t sequence) { return sequence & (FK_DUPLICATES_KEPT - 1u); }

static uint32_t answer_of(uint32_t sequence) { return sequence & (FK_DUPLICATES_ANSWERS - 1u); }

void fk_duplicates_forget(fk_duplicates_t *duplicates)
{
    for (uint32_t i = 0u; i < FK_DUPLICATES_KEPT; ++i) {
        duplicates->crc[i] = 0u;
    }
}

void fk_duplicates_init(fk_duplicates_t *duplicates)
{
    duplicates->newest = 0u;
    fk_duplicates_forget(duplicates);
}

const fk_kept_answer_t *fk_duplicates_find(const fk_duplicates_t *duplicates, const fk_frame_t *frame)
{
    static const fk_kept_answer_t had = {0u, 1u, {(uint8_t)FK_STATUS_DOUBLE}};
    const fk_kept_answer_t *kept = &duplicates->answers[answer_of(frame->sequence)];
    const uint32_t crc = duplicates->crc[place_of(frame->sequence)]; /* which is over the sequence number, too */
    if (crc == 0u || crc != frame->crc) {
        return 0;
    }
    return (kept->sequence == frame->sequence) ? kept : &had;
}

void fk_duplicates_note(fk_duplicates_t *duplicates, uint8_t sequence)
{
    const uint32_t ahead = (uint8_t)(sequence - duplicates->newest);
    if (ahead > NUMBERS - FK_DUPLICATES_KEPT) {
        return; /* late */
    }
    for (uint32_t i = 0u; i < ahead && i < FK_DUPLICATES_KEPT; ++i) {
        duplicates->crc[place_of((uint32_t)sequence - i)] = 0u;
    }
    duplicates->newest = sequence;
}

void fk_duplicates_keep(fk_duplicates_t *duplicates, const fk_frame_t *frame, const uint8_t *answer, uint32_t length)
{
    fk_kept_answer_t *kept = &duplicates->answers[answer_of(frame->sequence)];
    duplicates->crc[place_of(frame->sequence)] = frame->crc;
    kept->sequence = frame->sequence;
    kept->length = (uint8_t)length;
    for (uint32_t i = 0u; i < length; ++i) {
        kept->bytes[i] = answer[i];
    }
}
