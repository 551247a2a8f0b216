/* Frames of the link: COBS and CRC-32, and the collector that cuts a byte stream at its delimiters.
 * What stands in a frame is in fk_frames_layout.h.
 */
#ifndef FK_FRAMES_H
#define FK_FRAMES_H

#include <stdint.h>

#include "fk_frames_layout.h"

#define FK_FRAME_HEAD_BYTES 2u                                           /* type, sequence */
#define FK_FRAME_CRC_BYTES 4u
#define FK_FRAME_RAW_MAX (FK_FRAME_HEAD_BYTES + FK_PAYLOAD_BYTES_MAX + FK_FRAME_CRC_BYTES)
#define FK_FRAME_ENCODED_MAX (FK_FRAME_RAW_MAX + 2u)                     /* COBS code byte, delimiter */

/* COBS adds one byte for each 254 of content: one is enough while a raw frame stays below that. */
typedef char fk_frame_raw_fits_one_cobs_block[(FK_FRAME_RAW_MAX <= 253u) ? 1 : -1];

typedef struct {
    uint8_t bytes[FK_FRAME_ENCODED_MAX]; /* the frame so far, without its delimiter */
    uint32_t length;                     /* bytes so far; above the maximum: too long, wait for the delimiter */
} fk_frame_collector_t;

typedef struct {
    uint8_t type;
    uint8_t sequence;
    uint32_t crc; /* over type, sequence and payload */
    uint32_t payload_length;
    uint8_t payload[FK_PAYLOAD_BYTES_MAX];
} fk_frame_t;

/* Add one received byte.
 * @retval 0      no whole frame yet
 * @retval 1..    encoded length of the frame now in collector->bytes; it stays there until the next call
 * A frame that is too long is swallowed up to its delimiter and reported as length 1, which no decoder accepts,
 * so that it is counted as bad.
 */
uint32_t fk_frame_collect(fk_frame_collector_t *collector, uint8_t byte);

/* Decode one COBS frame (without delimiter) and check its CRC-32.
 * @retval 0   frame filled
 * @retval -1  not COBS, too short, too long or wrong CRC-32; frame is not to be used
 */
int32_t fk_frame_decode(const uint8_t *encoded, uint32_t length, fk_frame_t *frame);

/* Encode type, sequence and payload with CRC-32 and delimiter.
 * @param capacity  room at `to`, at least payload_length + 8 bytes
 * @retval 0    does not fit; nothing written
 * @retval 1..  bytes written
 */
uint32_t fk_frame_encode(uint8_t type, uint8_t sequence, const uint8_t *payload, uint32_t payload_length, uint8_t *to,
                         uint32_t capacity);

#endif
