#include "fk_frames.h"

#include "fk_planner.h"

uint32_t fk_frame_collect(fk_frame_collector_t *collector, uint8_t byte)
{
    if (byte != 0u) {
        if (collector->length < FK_FRAME_ENCODED_MAX) {
            collector->bytes[collector->length] = byte;
        }
        if (collector->length <= FK_FRAME_ENCODED_MAX) {
            ++collector->length;
        }
        return 0u;
    }
    uint32_t length = collector->length;
    collector->length = 0u;
    return (length > FK_FRAME_ENCODED_MAX) ? 1u : length;
}

/* COBS (Cheshire and Baker 1999): a code byte n stands before n - 1 bytes that are not zero; a zero follows them,
 * except after code 255 and at the end. Returns the decoded length, 0 where the bytes are not COBS or too many. */
static uint32_t cobs_decode(const uint8_t *encoded, uint32_t length, uint8_t *raw, uint32_t capacity)
{
    uint32_t from = 0u;
    uint32_t to = 0u;
    while (from < length) {
        uint32_t code = encoded[from];
        ++from;
        if (code == 0u || code - 1u > length - from || code - 1u > capacity - to) {
            return 0u;
        }
        for (uint32_t i = 1u; i < code; ++i) {
            if (encoded[from] == 0u) {
                return 0u;
            }
            raw[to] = encoded[from];
            ++to;
            ++from;
        }
        if (code < 255u && from < length) {
            if (to == capacity) {
                return 0u;
            }
            raw[to] = 0u;
            ++to;
        }
    }
    return to;
}

int32_t fk_frame_decode(const uint8_t *encoded, uint32_t length, fk_frame_t *frame)
{
    uint8_t raw[FK_FRAME_RAW_MAX];
    uint32_t count = cobs_decode(encoded, length, raw, FK_FRAME_RAW_MAX);
    if (count < FK_FRAME_HEAD_BYTES + FK_FRAME_CRC_BYTES) {
        return -1;
    }
    uint32_t checked = count - FK_FRAME_CRC_BYTES;
    uint32_t crc = fk_crc32(0u, raw, checked);
    if (crc != fk_get_u32(raw + checked)) {
        return -1;
    }
    frame->crc = crc;
    frame->type = raw[0];
    frame->sequence = raw[1];
    frame->payload_length = checked - FK_FRAME_HEAD_BYTES;
    for (uint32_t i = 0u; i < frame->payload_length; ++i) {
        frame->payload[i] = raw[FK_FRAME_HEAD_BYTES + i];
    }
    return 0;
}

uint32_t fk_frame_encode(uint8_t type, uint8_t sequence, const uint8_t *payload, uint32_t payload_length, uint8_t *to,
                         uint32_t capacity)
{
    uint8_t raw[FK_FRAME_RAW_MAX];
    uint32_t content = FK_FRAME_HEAD_BYTES + payload_length;
    uint32_t count = content + FK_FRAME_CRC_BYTES;
    if (payload_length > FK_PAYLOAD_BYTES_MAX || capacity < count + 2u) {
        return 0u;
    }
    raw[0] = type;
    raw[1] = sequence;
    for (uint32_t i = 0u; i < payload_length; ++i) {
        raw[FK_FRAME_HEAD_BYTES + i] = payload[i];
    }
    fk_put_u32(raw + content, fk_crc32(0u, raw, content));

    uint32_t code_at = 0u;
    uint32_t at = 1u;
    for (uint32_t i = 0u; i < count; ++i) {
        if (raw[i] == 0u) {
            to[code_at] = (uint8_t)(at - code_at);
            code_at = at;
        } else {
            to[at] = raw[i];
        }
        ++at;
    }
    to[code_at] = (uint8_t)(at - code_at);
    to[at] = 0u;
    return at + 1u;
}
