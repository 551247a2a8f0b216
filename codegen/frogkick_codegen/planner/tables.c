/* tables.c - table images: every check before use, then pointers into the image.
 *
 * Format version 1 has one layout for given counts; the sections follow each other without gaps:
 *   0 magic "FKTB"        4 u16 format version  6 u16 kind          8 u32 length of the image
 *  12 u32 CRC-32 of bytes [16, length)         16 char[16] robot id
 *  32 u8[32] provenance  64 u32 period_us      68 u32 pulse_us     72 u16 states
 *  74 u8 actions         75 u8 limbs           76 u32 offset of actions
 *  80 u32 offset of states                     84 u32 offset of transitions
 *  88 f32[3] velocity per code                100 f32[3] motion per code
 * 112 u32 second_delay_us                     116 u32[3] zero
 * actions: u8 name, first mask, second mask, zero; states: i16[3] each, then zeros to 4 bytes;
 * transitions: i16[6] for each state and action: three motion codes, three velocity codes. */
#include "fk_internal.h"

#define FK_KD_LEVELS_MAX 16U /* as in nearest.c */

/* A range of rows that one split has confined to a box. */
typedef struct {
    uint32_t low;
    uint32_t high;
    uint32_t axis;
    int32_t least[3]; /* codes, inclusive */
    int32_t most[3];
} fk_range_t;

uint32_t fk_crc32(uint32_t crc, const uint8_t *bytes, uint32_t length)
{
    /* Four bits at a time: 64 bytes of table, about 12 cycles for each byte on the chip. */
    static const uint32_t table[16] = {
        0x00000000U, 0x1DB71064U, 0x3B6E20C8U, 0x26D930ACU, 0x76DC4190U, 0x6B6B51F4U,
        0x4DB26158U, 0x5005713CU, 0xEDB88320U, 0xF00F9344U, 0xD6D6A3E8U, 0xCB61B38CU,
        0x9B64C2B0U, 0x86D3D2D4U, 0xA00AE278U, 0xBDBDF21CU,
    };
    uint32_t index;

    crc = ~crc;
    for (index = 0U; index < length; index++) {
        crc ^= bytes[index];
        crc = (crc >> 4) ^ table[crc & 15U];
        crc = (crc >> 4) ^ table[crc & 15U];
    }
    return ~crc;
}

/* Identity, size and integrity: after this every byte of the header may be believed to be as written. */
static int32_t fk_check_identity(const uint8_t *image, uint32_t size)
{
    if (size < FK_IMAGE_HEADER_BYTES) {
        return FK_ERROR_IMAGE_SIZE;
    }
    if ((image[0] != 0x46U) || (image[1] != 0x4BU) || (image[2] != 0x54U) || (image[3] != 0x42U)) {
        return FK_ERROR_IMAGE_MAGIC;
    }
    if (fk_read_u16(image + 4) != FK_FORMAT_VERSION) {
        return FK_ERROR_IMAGE_VERSION;
    }
    if (fk_read_u16(image + 6) != FK_KIND_NEAREST) {
        return FK_ERROR_IMAGE_KIND;
    }
    if (fk_read_u32(image + 8) != size) {
        return FK_ERROR_IMAGE_LENGTH;
    }
    if (fk_read_u32(image + 12) != fk_crc32(0U, image + 16, size - 16U)) {
        return FK_ERROR_IMAGE_CRC;
    }
    return FK_OK;
}

/* Counts and section offsets. Widest image: 128 + 128 + 393 212 + 65535 x 32 x 12 = 25 558 908 bytes, so
 * nothing here overflows uint32_t. */
static int32_t fk_check_layout(const uint8_t *image, uint32_t size)
{
    const uint32_t states = fk_read_u16(image + 72);
    const uint32_t actions = image[74];
    const uint32_t limbs = image[75];
    const uint32_t states_offset = FK_IMAGE_HEADER_BYTES + 4U * actions;
    const uint32_t transitions_offset = (states_offset + 6U * states + 3U) & ~3U;

    if ((states < 1U) || (actions < 1U) || (actions > FK_ACTIONS_MAX) || (limbs < 1U)
        || (limbs > FK_LIMBS_MAX)) {
        return FK_ERROR_IMAGE_COUNT;
    }
    if ((fk_read_u32(image + 76) != FK_IMAGE_HEADER_BYTES) || (fk_read_u32(image + 80) != states_offset)
        || (fk_read_u32(image + 84) != transitions_offset)
        || (size != transitions_offset + 12U * states * actions)) {
        return FK_ERROR_IMAGE_OFFSET;
    }
    return FK_OK;
}

static int32_t fk_check_robot_id(const uint8_t *robot_id)
{
    uint32_t length = 0U;
    uint32_t index;

    while ((length < FK_ROBOT_ID_BYTES) && (robot_id[length] != 0U)) {
        if ((robot_id[length] < 0x21U) || (robot_id[length] > 0x7EU)) {
            return FK_ERROR_IMAGE_ROBOT_ID;
        }
        length++;
    }
    if ((length < 1U) || (length == FK_ROBOT_ID_BYTES)) {
        return FK_ERROR_IMAGE_ROBOT_ID;
    }
    for (index = length; index < FK_ROBOT_ID_BYTES; index++) {
        if (robot_id[index] != 0U) {
            return FK_ERROR_IMAGE_ROBOT_ID;
        }
    }
    return FK_OK;
}

static int32_t fk_check_times_and_scales(const uint8_t *image)
{
    const uint32_t period_us = fk_read_u32(image + 64);
    const uint32_t pulse_us = fk_read_u32(image + 68);
    const uint32_t second_delay_us = fk_read_u32(image + 112);
    uint32_t index;

    if ((pulse_us < 1U) || (pulse_us >= period_us) || (second_delay_us >= period_us)) {
        return FK_ERROR_IMAGE_TIMES;
    }
    for (index = 0U; index < 6U; index++) {
        /* As bits: positive floats order like integers; negative ones, infinity and NaN lie above. */
        const uint32_t bits = fk_read_u32(image + 88U + 4U * index);
        if ((bits < fk_bits_of_float(FK_SCALE_MIN)) || (bits > fk_bits_of_float(FK_SCALE_MAX))) {
            return FK_ERROR_IMAGE_SCALE;
        }
    }
    for (index = 116U; index < FK_IMAGE_HEADER_BYTES; index++) {
        if (image[index] != 0U) {
            return FK_ERROR_IMAGE_PADDING;
        }
    }
    return FK_OK;
}

static int32_t fk_check_actions(const uint8_t *rows, uint32_t actions, uint32_t limbs)
{
    uint32_t index;
    uint32_t other;

    for (index = 0U; index < actions; index++) {
        const uint8_t *row = rows + 4U * index;
        const uint32_t masks = (uint32_t)row[1] | (uint32_t)row[2];
        if ((row[0] < 0x21U) || (row[0] > 0x7EU) || ((masks >> limbs) != 0U)) {
            return FK_ERROR_IMAGE_ACTION;
        }
        for (other = 0U; other < index; other++) {
            if (rows[4U * other] == row[0]) {
                return FK_ERROR_IMAGE_ACTION;
            }
        }
        if (row[3] != 0U) {
            return FK_ERROR_IMAGE_PADDING;
        }
    }
    return FK_OK;
}

/* Three codes within +-limit. */
static int32_t fk_check_codes(const uint8_t *codes, int32_t limit)
{
    uint32_t axis;

    for (axis = 0U; axis < 3U; axis++) {
        const int32_t code = fk_read_i16(codes + 2U * axis);
        if ((code > limit) || (code < -limit)) {
            return FK_ERROR_IMAGE_CODE;
        }
    }
    return FK_OK;
}

/* Every row lies on the right side of every split above it: otherwise a search would be wrong, silently. */
static int32_t fk_check_order(const uint8_t *rows, uint32_t states)
{
    /* One postponed upper range for each level at most. */
    fk_range_t waiting[FK_KD_LEVELS_MAX];
    fk_range_t range = {0U, states, 0U, {INT16_MIN, INT16_MIN, INT16_MIN}, {INT16_MAX, INT16_MAX, INT16_MAX}};
    uint32_t count = 0U;

    for (;;) {
        while (range.low < range.high) {
            const uint32_t middle = range.low + (range.high - range.low) / 2U;
            const uint32_t next_axis = (range.axis == 2U) ? 0U : range.axis + 1U;
            fk_range_t *upper = &waiting[count];
            int32_t split;
            uint32_t axis;
            for (axis = 0U; axis < 3U; axis++) {
                const int32_t code = fk_read_i16(rows + 6U * middle + 2U * axis);
                if ((code < range.least[axis]) || (code > range.most[axis])) {
                    return FK_ERROR_IMAGE_ORDER;
                }
            }
            split = fk_read_i16(rows + 6U * middle + 2U * range.axis);
            *upper = range;
            upper->low = middle + 1U;
            upper->axis = next_axis;
            upper->least[range.axis] = split;
            count += 1U;
            range.high = middle;
            range.most[range.axis] = split;
            range.axis = next_axis;
        }
        if (count == 0U) {
            return FK_OK;
        }
        count -= 1U;
        range = waiting[count];
    }
}

/* Paddings, codes and order of the two big sections; the layout stands. */
static int32_t fk_check_sections(const uint8_t *image)
{
    const uint32_t states = fk_read_u16(image + 72);
    const uint32_t transitions = states * image[74];
    const uint8_t *state_rows = image + fk_read_u32(image + 80);
    const uint8_t *transition_rows = image + fk_read_u32(image + 84);
    const uint8_t *padding;
    uint32_t index;

    for (padding = state_rows + 6U * states; padding < transition_rows; padding++) {
        if (*padding != 0U) {
            return FK_ERROR_IMAGE_PADDING;
        }
    }
    for (index = 0U; index < states; index++) {
        if (fk_check_codes(state_rows + 6U * index, FK_VELOCITY_CODE_MAX) != FK_OK) {
            return FK_ERROR_IMAGE_CODE;
        }
    }
    for (index = 0U; index < transitions; index++) {
        if ((fk_check_codes(transition_rows + 12U * index, FK_MOTION_CODE_MAX) != FK_OK)
            || (fk_check_codes(transition_rows + 12U * index + 6U, FK_VELOCITY_CODE_MAX) != FK_OK)) {
            return FK_ERROR_IMAGE_CODE;
        }
    }
    return fk_check_order(state_rows, states);
}

int32_t fk_tables_open(const uint8_t *image, uint32_t size, fk_tables_t *tables)
{
    uint32_t index;
    int32_t error;

    if ((image == NULL) || (tables == NULL)) {
        return FK_ERROR_NULL;
    }
    error = fk_float_check();
    if (error == FK_OK) {
        error = fk_check_identity(image, size);
    }
    if (error == FK_OK) {
        error = fk_check_layout(image, size);
    }
    if (error == FK_OK) {
        error = fk_check_robot_id(image + 16);
    }
    if (error == FK_OK) {
        error = fk_check_times_and_scales(image);
    }
    if (error == FK_OK) {
        error = fk_check_actions(image + FK_IMAGE_HEADER_BYTES, image[74], image[75]);
    }
    if (error == FK_OK) {
        error = fk_check_sections(image);
    }
    if (error != FK_OK) {
        return error;
    }

    tables->action_rows = image + FK_IMAGE_HEADER_BYTES;
    tables->state_rows = image + fk_read_u32(image + 80);
    tables->transition_rows = image + fk_read_u32(image + 84);
    tables->provenance = image + 32;
    tables->image_bytes = size;
    tables->image_crc32 = fk_read_u32(image + 12);
    tables->period_us = fk_read_u32(image + 64);
    tables->pulse_us = fk_read_u32(image + 68);
    tables->second_delay_us = fk_read_u32(image + 112);
    for (index = 0U; index < 3U; index++) {
        tables->velocity_scale[index] = fk_read_f32(image + 88U + 4U * index);
        tables->codes_per_velocity[index] = 1.0f / tables->velocity_scale[index];
        tables->motion_scale[index] = fk_read_f32(image + 100U + 4U * index);
    }
    tables->states = (uint16_t)fk_read_u16(image + 72);
    tables->actions = image[74];
    tables->limbs = image[75];
    for (index = 0U; index < FK_ROBOT_ID_BYTES; index++) {
        tables->robot_id[index] = (char)image[16U + index]; /* printable ASCII or NUL, checked */
    }
    return FK_OK;
}

int32_t fk_tables_check_robot(const fk_tables_t *tables, const char *robot_id)
{
    uint32_t index;

    if ((tables == NULL) || (robot_id == NULL)) {
        return FK_ERROR_NULL;
    }
    for (index = 0U; index < FK_ROBOT_ID_BYTES; index++) {
        if (tables->robot_id[index] != robot_id[index]) {
            return FK_ERROR_ROBOT;
        }
        if (robot_id[index] == '\0') {
            break;
        }
    }
    return FK_OK;
}

int32_t fk_tables_action(const fk_tables_t *tables, uint8_t index, fk_action_t *action)
{
    const uint8_t *row;

    if ((tables == NULL) || (action == NULL)) {
        return FK_ERROR_NULL;
    }
    if (index >= tables->actions) {
        return FK_ERROR_ACTION;
    }
    row = tables->action_rows + 4U * (uint32_t)index;
    action->name = (char)row[0];
    action->first_mask = row[1];
    action->second_mask = row[2];
    return FK_OK;
}
