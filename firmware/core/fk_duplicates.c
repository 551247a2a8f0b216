#include "fk_duplicates.h"

#define FORGOTTEN 255u
#define PLACES (FK_DUPLICATES_KEPT + FK_DUPLICATES_CHUNKS)

void fk_duplicates_init(fk_duplicates_t *duplicates)
{
    for (uint32_t i = 0u; i < PLACES; ++i) {
        duplicates->kept[i].age = FORGOTTEN;
    }
    duplicates->next = 0u;
    duplicates->next_chunk = FK_DUPLICATES_KEPT;
    duplicates->newest = 0u;
}

void fk_duplicates_note(fk_duplicates_t *duplicates, uint8_t sequence)
{
    /* Half of all numbers lie ahead; one of the other half is late. */
    uint32_t ahead = (uint8_t)(sequence - duplicates->newest);
    if (ahead > FK_DUPLICATES_SPAN) {
        return;
    }
    duplicates->newest = sequence;
    for (uint32_t i = 0u; i < PLACES; ++i) {
        uint32_t age = duplicates->kept[i].age + ahead;
        duplicates->kept[i].age = (uint8_t)((age > FK_DUPLICATES_SPAN) ? FORGOTTEN : age);
    }
}

const fk_duplicate_t *fk_duplicates_find(const fk_duplicates_t *duplicates, const fk_frame_t *frame)
{
    for (uint32_t i = 0u; i < PLACES; ++i) {
        const fk_duplicate_t *one = &duplicates->kept[i];
        if (one->age <= FK_DUPLICATES_SPAN && one->sequence == frame->sequence && one->crc == frame->crc) {
            return one;
        }
    }
    return 0;
}

void fk_duplicates_keep(fk_duplicates_t *duplicates, const fk_frame_t *frame, const uint8_t *answer, uint32_t length)
{
    const int32_t is_chunk = frame->type == FK_FRAME_TABLE_CHUNK;
    fk_duplicate_t *one = &duplicates->kept[is_chunk ? duplicates->next_chunk : duplicates->next];
    one->crc = frame->crc;
    one->sequence = frame->sequence;
    one->age = (uint8_t)(duplicates->newest - frame->sequence);
    one->length = (uint8_t)length;
    for (uint32_t i = 0u; i < length; ++i) {
        one->answer[i] = answer[i];
    }
    if (is_chunk) {
        duplicates->next_chunk = (duplicates->next_chunk + 1u < PLACES) ? duplicates->next_chunk + 1u : FK_DUPLICATES_KEPT;
    } else {
        duplicates->next = (duplicates->next + 1u) % FK_DUPLICATES_KEPT;
    }
}
