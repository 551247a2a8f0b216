#include "fk_repeats.h"

#define FORGOTTEN 255u

void fk_repeats_init(fk_repeats_t *repeats)
{
    for (uint32_t i = 0u; i < FK_REPEATS_KEPT; ++i) {
        repeats->kept[i].age = FORGOTTEN;
    }
    repeats->next = 0u;
    repeats->newest = 0u;
}

void fk_repeats_note(fk_repeats_t *repeats, uint8_t sequence)
{
    /* Half of all numbers lie ahead; one of the other half is late. */
    uint32_t ahead = (uint8_t)(sequence - repeats->newest);
    if (ahead > FK_REPEATS_SPAN) {
        return;
    }
    repeats->newest = sequence;
    for (uint32_t i = 0u; i < FK_REPEATS_KEPT; ++i) {
        uint32_t age = repeats->kept[i].age + ahead;
        repeats->kept[i].age = (uint8_t)((age > FK_REPEATS_SPAN) ? FORGOTTEN : age);
    }
}

const fk_repeat_t *fk_repeats_find(const fk_repeats_t *repeats, const fk_frame_t *frame)
{
    for (uint32_t i = 0u; i < FK_REPEATS_KEPT; ++i) {
        const fk_repeat_t *one = &repeats->kept[i];
        if (one->age <= FK_REPEATS_SPAN && one->sequence == frame->sequence && one->crc == frame->crc) {
            return one;
        }
    }
    return 0;
}

void fk_repeats_keep(fk_repeats_t *repeats, const fk_frame_t *frame, const uint8_t *answer, uint32_t length)
{
    fk_repeat_t *one = &repeats->kept[repeats->next];
    one->crc = frame->crc;
    one->sequence = frame->sequence;
    one->age = (uint8_t)(repeats->newest - frame->sequence);
    one->length = (uint8_t)length;
    for (uint32_t i = 0u; i < length; ++i) {
        one->answer[i] = answer[i];
    }
    repeats->next = (repeats->next + 1u) % FK_REPEATS_KEPT;
}
