/* tables.c - table images: opened when fk_image_check() has passed every byte, then pointers into them.
 *
 * Format version 3, or 2 where k is 0; little-endian; the sections follow each other without gaps, each on 4 bytes:
 *   0 magic "FKTB"        4 u16 format version  6 u16 kind          8 u32 length of the image
 *  12 u32 CRC-32 of bytes [16, length)         16 char[16] robot id
 *  32 u8[32] provenance  64 u32 period_us      68 u32 pulse_us     72 u16 states n
 *  74 u8 actions a       75 u8 limbs l         76 u32 offset of actions
 *  80 u32 offset of states                     84 u32 offset of transitions
 *  88 f32[3] velocity per code                100 f32[3] motion per code
 * 112 u32 second_delay_us                     116 u32 offset of columns
 * 120 u32 offset of splits                    124 u32 offset of models
 * 128 u16 bytes of a state's transitions r    130 u8 tree levels t  131 u8 block levels b
 * 132 u16[3] motion limits                    138 u16[3] offset limits (affine)
 * 144 u8[6] shifts      150 u16[6] codes per unit of a residual     162 u8[3] up (nearest)
 * 165 u8 wear knots k   166 u16 use decay     168 u16 use gain      170 u16 zero
 * 172 u32 axes of the tree's levels: two bits each, the root's the lowest; 0 above
 * actions: u8 name, first mask, second mask, zero
 * columns: [a][6] of: nearest u16 bit offset in a state's transitions, u8 bits, u8 zero; affine i16[3] least
 *   derivatives, i16 least value, i16[4] history, or i16[8] of more than 4 limbs, 0 beyond the limbs
 * wear: i16[l][k][6] what a limb that has lost (j + 1) / k of its contribution changes of an action that fires it
 * splits: i16[2^t - 1] in heap order: no code on its level's axis is above it to the left, below to the right
 * models: nearest i16[2^b][a][6][10]; affine none
 * states: i16[n][3]; leaf i of the tree holds rows [(i n) >> t, ((i + 1) n) >> t), block i likewise with b
 * transitions: u8[n][r], each an unsigned residual for every column, least significant bit first, for affine
 *   three of 7 bits and one of 11; then at least 3 zeros. Splits, states and transitions end with zeros to 4 bytes.
 * lookup.c says how values come out of these. */
#include "fk_internal.h"

/* The box that holds all states; image and counts are checked. */
static void fk_bound_states(fk_tables_t *tables)
{
    uint32_t index;
    uint32_t axis;

    for (axis = 0U; axis < 3U; axis++) {
        tables->state_least[axis] = FK_VELOCITY_CODE_MAX;
        tables->state_most[axis] = -FK_VELOCITY_CODE_MAX;
    }
    for (index = 0U; index < tables->states; index++) {
        for (axis = 0U; axis < 3U; axis++) {
            const int32_t code = fk_read_i16(tables->state_rows + 6U * index + 2U * axis);
            if (code < tables->state_least[axis]) {
                tables->state_least[axis] = code;
            }
            if (code > tables->state_most[axis]) {
                tables->state_most[axis] = code;
            }
        }
    }
}

int32_t fk_tables_open(const uint8_t *image, uint32_t size, fk_tables_t *tables)
{
    uint32_t index;
    float forward_m;
    float left_m;
    int32_t error;

    if ((image == NULL) || (tables == NULL)) {
        return FK_ERROR_NULL;
    }
    error = fk_float_check();
    if (error == FK_OK) {
        error = fk_image_check(image, size);
    }
    if (error != FK_OK) {
        return error;
    }

    tables->action_rows = image + fk_read_u32(image + 76);
    tables->columns = image + fk_read_u32(image + 116);
    tables->splits = image + fk_read_u32(image + 120);
    tables->wear_knots = image[165];
    tables->wear_curves = tables->splits - 12U * image[75] * image[165];
    tables->worn = NULL;
    tables->models = image + fk_read_u32(image + 124);
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
        tables->motion_limit[index] = (int32_t)fk_read_u16(image + 132U + 2U * index);
        tables->offset_limit[index] = (int32_t)fk_read_u16(image + 138U + 2U * index);
        tables->up[index] = image[162U + index];
    }
    for (index = 0U; index < 6U; index++) {
        tables->shift[index] = image[144U + index];
        tables->unit[index] = (uint16_t)fk_read_u16(image + 150U + 2U * index);
    }
    forward_m = (float)tables->motion_limit[0] * tables->motion_scale[0];
    left_m = (float)tables->motion_limit[1] * tables->motion_scale[1];
    tables->stroke_max_m = FK_SQRT(forward_m * forward_m + left_m * left_m);
    tables->turn_max_rad = (float)tables->motion_limit[2] * tables->motion_scale[2];
    tables->states = (uint16_t)fk_read_u16(image + 72);
    tables->row_bytes = (uint16_t)fk_read_u16(image + 128);
    tables->use_decay = (uint16_t)fk_read_u16(image + 166);
    tables->use_gain = (uint16_t)fk_read_u16(image + 168);
    tables->axes = fk_read_u32(image + 172);
    tables->kind = image[6];
    tables->tree_levels = image[130];
    tables->block_levels = image[131];
    tables->actions = image[74];
    tables->limbs = image[75];
    for (index = 0U; index < FK_ROBOT_ID_BYTES; index++) {
        tables->robot_id[index] = (char)image[16U + index]; /* printable ASCII or NUL, checked */
    }
    fk_bound_states(tables);
    return FK_OK;
}

int32_t fk_tables_check_robot(const fk_tables_t *tables, const char *robot_id)
{
    uint32_t index = 0U;

    if ((tables == NULL) || (robot_id == NULL)) {
        return FK_ERROR_NULL;
    }
    /* The table's id ends with a NUL within FK_ROBOT_ID_BYTES (checked), where a longer one differs. */
    while ((robot_id[index] != '\0') && (robot_id[index] == tables->robot_id[index])) {
        index++;
    }
    return (robot_id[index] == tables->robot_id[index]) ? FK_OK : FK_ERROR_ROBOT;
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
