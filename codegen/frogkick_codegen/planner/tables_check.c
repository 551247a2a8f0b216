/* tables_check.c - every check of a table image before anything of it is used; tables.c has the format. */
#include "fk_internal.h"

#define FK_COEFFICIENT_SUM_MAX 131071U /* of |coefficients|; fk_predict() in lookup.c says why */
#define FK_RESIDUAL_CODES_MAX 1048575U /* a residual's codes, below 2^20 */
#define FK_HISTORY_SUM_MAX 65535U      /* of |history|; fk_correct() says why */
#define FK_BITS_MAX 16U                /* of a residual */
#define FK_ROW_BYTES_MAX 24U           /* of one action */
#define FK_AFFINE_DERIVATIVE_MAX 127   /* 7 bits */
#define FK_AFFINE_VALUE_MAX 2047U      /* 11 bits */

/* Counts, sizes and offsets from the header, once they are known to be in range. */
typedef struct {
    uint32_t kind;
    uint32_t states;
    uint32_t actions;
    uint32_t limbs;
    uint32_t tree_levels;
    uint32_t block_levels;
    uint32_t row_bytes;
    uint32_t axes;
    uint32_t column_bytes;
    uint32_t wear_knots;
    uint32_t columns_at; /* offsets */
    uint32_t splits_at;
    uint32_t models_at;
    uint32_t states_at;
    uint32_t transitions_at;
} fk_shape_t;

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

/* Identity, size and integrity: after this every byte of the image is as it was written. */
static int32_t fk_check_identity(const uint8_t *image, uint32_t size)
{
    uint32_t version;

    if (size < FK_IMAGE_HEADER_BYTES) {
        return FK_ERROR_IMAGE_SIZE;
    }
    if ((image[0] != 0x46U) || (image[1] != 0x4BU) || (image[2] != 0x54U) || (image[3] != 0x42U)) {
        return FK_ERROR_IMAGE_MAGIC;
    }
    version = fk_read_u16(image + 4);
    if ((version != FK_FORMAT_VERSION) && (version != FK_FORMAT_PLAIN)) {
        return FK_ERROR_IMAGE_VERSION;
    }
    if ((fk_read_u16(image + 6) != FK_KIND_NEAREST) && (fk_read_u16(image + 6) != FK_KIND_AFFINE)) {
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

static uint32_t fk_to_four(uint32_t offset)
{
    return (offset + 3U) & ~3U;
}

/* Counts and section offsets. Widest image: 176 + 128 + 5376 + 1536 + 16384 + 983 040 + 393 212 + 65535 x 768 is
 * about 52 million bytes, so nothing here overflows uint32_t. */
static int32_t fk_check_layout(const uint8_t *image, uint32_t size, fk_shape_t *shape)
{
    uint32_t block_levels_max;

    shape->kind = fk_read_u16(image + 6);
    shape->states = fk_read_u16(image + 72);
    shape->actions = image[74];
    shape->limbs = image[75];
    shape->tree_levels = image[130];
    shape->block_levels = image[131];
    shape->row_bytes = fk_read_u16(image + 128);
    shape->axes = fk_read_u32(image + 172);
    shape->wear_knots = image[165];
    block_levels_max = (shape->kind == FK_KIND_NEAREST) ? FK_BLOCK_LEVELS_MAX : 0U;
    if ((shape->states < 1U) || (shape->actions < 1U) || (shape->actions > FK_ACTIONS_MAX)
        || (shape->limbs < 1U) || (shape->limbs > FK_LIMBS_MAX) || (shape->tree_levels > FK_TREE_LEVELS_MAX)
        || ((1U << shape->tree_levels) > shape->states) || (shape->block_levels > block_levels_max)
        || ((1U << shape->block_levels) > shape->states)
        || (shape->wear_knots > FK_WEAR_KNOTS_MAX)
        || ((shape->wear_knots > 0U) != (fk_read_u16(image + 4) == FK_FORMAT_VERSION))) {
        return FK_ERROR_IMAGE_COUNT;
    }
    shape->column_bytes = (shape->kind == FK_KIND_NEAREST) ? 4U : FK_AFFINE_COLUMN_BYTES(shape->limbs);
    shape->columns_at = FK_IMAGE_HEADER_BYTES + 4U * shape->actions;
    shape->splits_at = shape->columns_at + 6U * shape->actions * shape->column_bytes
                     + 12U * shape->limbs * shape->wear_knots;
    shape->models_at = fk_to_four(shape->splits_at + 2U * ((1U << shape->tree_levels) - 1U));
    shape->states_at = shape->models_at;
    if (shape->kind == FK_KIND_NEAREST) {
        shape->states_at += (12U * FK_COEFFICIENTS * shape->actions) << shape->block_levels;
    }
    shape->transitions_at = fk_to_four(shape->states_at + 6U * shape->states);
    if ((shape->row_bytes > FK_ROW_BYTES_MAX * shape->actions)
        || (fk_read_u32(image + 76) != FK_IMAGE_HEADER_BYTES)
        || (fk_read_u32(image + 116) != shape->columns_at) || (fk_read_u32(image + 120) != shape->splits_at)
        || (fk_read_u32(image + 124) != shape->models_at) || (fk_read_u32(image + 80) != shape->states_at)
        || (fk_read_u32(image + 84) != shape->transitions_at)
        || (size != fk_to_four(shape->transitions_at + shape->row_bytes * shape->states + 3U))) {
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

/* u16 values from least to most. */
static int32_t fk_check_u16(const uint8_t *values, uint32_t count, uint32_t least, uint32_t most)
{
    uint32_t index;

    for (index = 0U; index < count; index++) {
        const uint32_t value = fk_read_u16(values + 2U * index);
        if ((value < least) || (value > most)) {
            return FK_ERROR_IMAGE_SCALE;
        }
    }
    return FK_OK;
}

/* Scales, limits, shifts, units and the limbs' decay and gain. */
static int32_t fk_check_numbers(const uint8_t *image, uint32_t kind)
{
    const uint32_t affine = (kind == FK_KIND_AFFINE) ? 1U : 0U;
    const uint32_t shift_least = (affine != 0U) ? 0U : 14U;
    const uint32_t shift_most = (affine != 0U) ? 15U : 20U;
    const uint32_t up_most = (affine != 0U) ? 0U : 14U;
    uint32_t index;

    for (index = 0U; index < 6U; index++) {
        /* As bits: positive floats order like integers; negative ones, infinity and NaN lie above. */
        const uint32_t bits = fk_read_u32(image + 88U + 4U * index);
        if ((bits < fk_bits_of_float(FK_SCALE_MIN)) || (bits > fk_bits_of_float(FK_SCALE_MAX))
            || (image[144U + index] < shift_least) || (image[144U + index] > shift_most)) {
            return FK_ERROR_IMAGE_SCALE;
        }
    }
    for (index = 0U; index < 3U; index++) {
        if (image[162U + index] > up_most) {
            return FK_ERROR_IMAGE_SCALE;
        }
    }
    if ((fk_check_u16(image + 132, 3U, 1U, (uint32_t)FK_MOTION_CODE_MAX) != FK_OK)
        || (fk_check_u16(image + 138, 3U, 0U, affine * (uint32_t)FK_VELOCITY_CODE_MAX) != FK_OK)
        || (fk_check_u16(image + 150, 6U, 1U, UINT16_MAX) != FK_OK)
        || (fk_check_u16(image + 166, 2U, 0U, affine * FK_LIMB_USE_MAX) != FK_OK)) {
        return FK_ERROR_IMAGE_SCALE;
    }
    return FK_OK;
}

/* One axis of 0, 1, 2 for each level of the search tree. */
static int32_t fk_check_axes(const fk_shape_t *shape)
{
    uint32_t level;

    for (level = 0U; level < shape->tree_levels; level++) {
        if (((shape->axes >> (2U * level)) & 3U) == 3U) {
            return FK_ERROR_IMAGE_ORDER;
        }
    }
    return ((shape->axes >> (2U * shape->tree_levels)) == 0U) ? FK_OK : FK_ERROR_IMAGE_ORDER;
}

static int32_t fk_check_times(const uint8_t *image)
{
    const uint32_t period_us = fk_read_u32(image + 64);
    const uint32_t pulse_us = fk_read_u32(image + 68);
    const uint32_t second_delay_us = fk_read_u32(image + 112);

    if ((pulse_us < 1U) || (pulse_us >= period_us) || (second_delay_us >= period_us)) {
        return FK_ERROR_IMAGE_TIMES;
    }
    return FK_OK;
}

/* Bytes [from, to) are zero. */
static int32_t fk_check_zeros(const uint8_t *image, uint32_t from, uint32_t to)
{
    uint32_t index;

    for (index = from; index < to; index++) {
        if (image[index] != 0U) {
            return FK_ERROR_IMAGE_PADDING;
        }
    }
    return FK_OK;
}

static int32_t fk_check_paddings(const uint8_t *image, uint32_t size, const fk_shape_t *shape)
{
    const uint32_t splits_end = shape->splits_at + 2U * ((1U << shape->tree_levels) - 1U);

    if ((fk_check_zeros(image, 170U, 172U) != FK_OK)
        || (fk_check_zeros(image, splits_end, shape->models_at) != FK_OK)
        || (fk_check_zeros(image, shape->states_at + 6U * shape->states, shape->transitions_at) != FK_OK)
        || (fk_check_zeros(image, shape->transitions_at + shape->row_bytes * shape->states, size) != FK_OK)) {
        return FK_ERROR_IMAGE_PADDING;
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

static uint32_t fk_magnitude(int32_t value)
{
    return (uint32_t)((value < 0) ? -value : value);
}

/* Kind affine: no sum of a correction overflows. */
static int32_t fk_check_affine_column(const uint8_t *column, uint32_t limbs, uint32_t unit)
{
    uint32_t sum = 0U;
    uint32_t index;

    for (index = 0U; index < 4U; index++) {
        const int32_t least = fk_read_i16(column + 2U * index);
        if ((least == INT16_MIN) || ((index < 3U) && (least > INT16_MAX - FK_AFFINE_DERIVATIVE_MAX))) {
            return FK_ERROR_IMAGE_CODE;
        }
    }
    for (index = 0U; index < limbs; index++) {
        const int32_t history = fk_read_i16(column + 8U + 2U * index);
        if (history == INT16_MIN) {
            return FK_ERROR_IMAGE_CODE;
        }
        sum += fk_magnitude(history);
    }
    if (sum > FK_HISTORY_SUM_MAX) {
        return FK_ERROR_IMAGE_CODE;
    }
    return (FK_AFFINE_VALUE_MAX * unit > FK_RESIDUAL_CODES_MAX) ? FK_ERROR_IMAGE_COLUMN : FK_OK;
}

/* The columns: how a state's transitions are read, and that they add up to its bytes. */
static int32_t fk_check_columns(const uint8_t *image, const fk_shape_t *shape)
{
    const uint32_t affine = (shape->kind == FK_KIND_AFFINE) ? 1U : 0U;
    const uint32_t zeros_at = (affine != 0U) ? 8U + 2U * shape->limbs : 3U;
    uint32_t at = 0U;
    uint32_t index;

    for (index = 0U; index < 6U * shape->actions; index++) {
        const uint8_t *column = image + shape->columns_at + shape->column_bytes * index;
        const uint32_t unit = fk_read_u16(image + 150U + 2U * (index % 6U));
        if (affine != 0U) {
            const int32_t error = fk_check_affine_column(column, shape->limbs, unit);
            if (error != FK_OK) {
                return error;
            }
            at += 32U;
        } else {
            /* Widest: 65535 x 65535 < 2^32. */
            if ((fk_read_u16(column) != at) || (column[2] > FK_BITS_MAX)
                || (((1U << column[2]) - 1U) * unit > FK_RESIDUAL_CODES_MAX)) {
                return FK_ERROR_IMAGE_COLUMN;
            }
            at += column[2];
        }
        if (fk_check_zeros(column, zeros_at, shape->column_bytes) != FK_OK) {
            return FK_ERROR_IMAGE_PADDING;
        }
    }
    return (shape->row_bytes == (at + 7U) / 8U) ? FK_OK : FK_ERROR_IMAGE_COLUMN;
}

/* Kind nearest: no sum of a prediction overflows. */
static int32_t fk_check_models(const uint8_t *image, const fk_shape_t *shape)
{
    const uint8_t *model;
    uint32_t index;

    for (model = image + shape->models_at; model < image + shape->states_at; model += 2U * FK_COEFFICIENTS) {
        uint32_t sum = 0U;
        for (index = 0U; index < FK_COEFFICIENTS; index++) {
            sum += fk_magnitude(fk_read_i16(model + 2U * index));
        }
        if (sum > FK_COEFFICIENT_SUM_MAX) {
            return FK_ERROR_IMAGE_CODE;
        }
    }
    return FK_OK;
}

/* Splits and states within their codes, and curves within +-32767. */
static int32_t fk_check_codes(const uint8_t *image, const fk_shape_t *shape)
{
    const uint32_t splits = (1U << shape->tree_levels) - 1U;
    const uint8_t *curve = image + shape->splits_at - 12U * shape->limbs * shape->wear_knots;
    uint32_t index;

    for (; curve < image + shape->splits_at; curve += 2) {
        if (fk_read_i16(curve) == INT16_MIN) {
            return FK_ERROR_IMAGE_CODE;
        }
    }
    for (index = 0U; index < splits; index++) {
        if (fk_magnitude(fk_read_i16(image + shape->splits_at + 2U * index)) > (uint32_t)FK_VELOCITY_CODE_MAX) {
            return FK_ERROR_IMAGE_CODE;
        }
    }
    for (index = 0U; index < 3U * shape->states; index++) {
        const uint32_t most = (uint32_t)FK_VELOCITY_CODE_MAX >> image[162U + index % 3U];
        if (fk_magnitude(fk_read_i16(image + shape->states_at + 2U * index)) > most) {
            return FK_ERROR_IMAGE_CODE;
        }
    }
    return FK_OK;
}

/* Every row lies on the right side of every split above it: otherwise a search would be wrong, silently. */
static int32_t fk_check_order(const uint8_t *image, const fk_shape_t *shape)
{
    uint32_t leaf;

    for (leaf = 0U; leaf < (1U << shape->tree_levels); leaf++) {
        int32_t least[3] = {INT16_MIN, INT16_MIN, INT16_MIN};
        int32_t most[3] = {INT16_MAX, INT16_MAX, INT16_MAX};
        const uint32_t end = ((leaf + 1U) * shape->states) >> shape->tree_levels;
        uint32_t axis;
        uint32_t level;
        uint32_t row;

        for (level = 0U; level < shape->tree_levels; level++) {
            const uint32_t below = shape->tree_levels - level; /* levels from this node to the leaf */
            const uint32_t node = (1U << level) - 1U + (leaf >> below);
            const int32_t split = fk_read_i16(image + shape->splits_at + 2U * node);
            axis = (shape->axes >> (2U * level)) & 3U;
            if (((leaf >> (below - 1U)) & 1U) != 0U) {
                least[axis] = (split > least[axis]) ? split : least[axis];
            } else {
                most[axis] = (split < most[axis]) ? split : most[axis];
            }
        }
        for (row = (leaf * shape->states) >> shape->tree_levels; row < end; row++) {
            for (axis = 0U; axis < 3U; axis++) {
                const int32_t code = fk_read_i16(image + shape->states_at + 6U * row + 2U * axis);
                if ((code < least[axis]) || (code > most[axis])) {
                    return FK_ERROR_IMAGE_ORDER;
                }
            }
        }
    }
    return FK_OK;
}

int32_t fk_image_check(const uint8_t *image, uint32_t size)
{
    fk_shape_t shape;
    int32_t error = fk_check_identity(image, size);

    error = (error == FK_OK) ? fk_check_layout(image, size, &shape) : error;
    error = (error == FK_OK) ? fk_check_robot_id(image + 16) : error;
    error = (error == FK_OK) ? fk_check_times(image) : error;
    error = (error == FK_OK) ? fk_check_numbers(image, shape.kind) : error;
    error = (error == FK_OK) ? fk_check_paddings(image, size, &shape) : error;
    error = (error == FK_OK) ? fk_check_actions(image + FK_IMAGE_HEADER_BYTES, shape.actions, shape.limbs) : error;
    error = (error == FK_OK) ? fk_check_columns(image, &shape) : error;
    error = (error == FK_OK) ? fk_check_models(image, &shape) : error;
    error = (error == FK_OK) ? fk_check_codes(image, &shape) : error;
    error = (error == FK_OK) ? fk_check_axes(&shape) : error;
    return (error == FK_OK) ? fk_check_order(image, &shape) : error;
}
