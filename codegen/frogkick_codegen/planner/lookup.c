/* lookup.c - what a table predicts for a state: decoded by kind, corrected, clamped.
 *
 * Every value is clamped to its limit, so whatever an image holds, a motion stays within stroke_max_m and
 * turn_max_rad and a velocity within its code. fk_tables_open() has checked what the widths below rest on. */
#include "fk_internal.h"

static int32_t fk_clamp(int32_t value, int32_t limit)
{
    if (value > limit) {
        return limit;
    }
    return (value < -limit) ? -limit : value;
}

/* Kind nearest: the block's quadratic of the row's codes, and the residual. Widths: a factor is within
 * +-16384 and |coefficients| sum to 131 071 at most, so the sum is within +-2 147 467 264 < 2^31; it shifts
 * to +-131 071, and a residual adds less than 2^20. */
static inline void fk_predict(const fk_tables_t *tables, const fk_lookup_t *lookup, uint32_t action,
                              uint32_t first, int32_t codes[3])
{
    const uint32_t place = 6U * action + first;
    const uint8_t *coefficients = lookup->model + 2U * FK_COEFFICIENTS * place;
    const uint8_t *column = tables->columns + 4U * place;
    uint32_t value;

    for (value = 0U; value < 3U; value++) {
        const uint32_t shift = tables->shift[first + value];
        const uint32_t head = fk_read_u32(column); /* u16 bit offset, u8 bits */
        const uint32_t at = head & 0xFFFFU;
        /* At most 16 bits, so the 4 bytes from the first one hold it. The transitions end with 3 bytes of
         * padding at least, so that the last read stays within the image. */
        const uint32_t word = fk_read_u32(lookup->residuals + (at >> 3)) >> (at & 7U);
        const uint32_t residual = word & ((1U << (head >> 16)) - 1U);
        int32_t sum = 0;
        uint32_t index;
        for (index = 0U; index < FK_COEFFICIENTS / 2U; index++) {
            sum = fk_add_products(sum, fk_read_u32(coefficients + 4U * index), lookup->factors[index]);
        }
        codes[value] = (sum >> shift) + (int32_t)(residual * tables->unit[first + value]);
        coefficients += 2U * FK_COEFFICIENTS;
        column += 4;
    }
}

/* Kind affine: the row's value, its derivatives times the offset, the limbs' history. A residual is one word,
 * 7 bits for each of three derivatives, 11 for the value. One column is
 *   i16[3] least derivatives, i16 least value, i16 history of four limbs, or of eight where there are more.
 * Widths: a value is within +-(32767 + 2^20); a derivative within +-32767, so that two of them are added as
 * halves, and an offset within +-16383, so three products and a half of 2^15 stay below 1.62e9 < 2^31; |history|
 * sums to 65535 at most and a use is within +-32768 whatever it says, so those products stay below 2^31. Shifts of
 * negative numbers are arithmetic, towards minus infinity, as every compiler that builds for this chip defines
 * them. */
static inline void fk_correct(const fk_tables_t *tables, const fk_lookup_t *lookup, uint32_t action,
                              uint32_t first, int32_t codes[3])
{
    const uint32_t column_bytes = FK_AFFINE_COLUMN_BYTES(tables->limbs);
    const uint32_t place = 6U * action + first;
    const uint8_t *column = tables->columns + column_bytes * place;
    const uint8_t *residual = lookup->residuals + 4U * place;
    const uint32_t offsets = fk_pair(lookup->offset[0], lookup->offset[1]);
    uint32_t value;

    FK_ROLLED
    for (value = 0U; value < 3U; value++) {
        const uint32_t word = fk_read_u32(residual);
        const uint32_t shift = tables->shift[first + value];
        uint32_t two = fk_add_halves(fk_read_u32(column), (word & 127U) | ((word << 9) & 0x7F0000U));
        int32_t code = (int32_t)((word >> 21) * tables->unit[first + value]);
        int32_t sum = fk_add_products((int32_t)((1U << shift) >> 1), two, offsets);

        two = fk_read_u32(column + 4);
        sum += (fk_low(two) + (int32_t)((word >> 14) & 127U)) * lookup->offset[2];
        code += fk_high(two) + (sum >> shift);
        sum = fk_add_products(0, fk_read_u32(column + 8), lookup->factors[0]);
        sum = fk_add_products(sum, fk_read_u32(column + 12), lookup->factors[1]);
        if (FK_SELDOM(column_bytes > 16U)) {
            sum = fk_add_products(sum, fk_read_u32(column + 16), lookup->factors[2]);
            sum = fk_add_products(sum, fk_read_u32(column + 20), lookup->factors[3]);
        }
        codes[value] = code + (sum >> 15);
        column += column_bytes;
        residual += 4;
    }
}

/* Three values of a transition, from `first` on, with the change by worn limbs, before they are clamped. That
 * change is an int16, so the sum stays far below 2^31. */
FK_INLINE void fk_decode(const fk_tables_t *tables, const fk_lookup_t *lookup, uint32_t action, uint32_t first,
                         int32_t codes[3])
{
    if (tables->kind == FK_KIND_NEAREST) {
        fk_predict(tables, lookup, action, first, codes);
    } else {
        fk_correct(tables, lookup, action, first, codes);
    }
    if (tables->worn != NULL) {
        const int16_t *shift = tables->worn + 6U * action + first;
        codes[0] += shift[0];
        codes[1] += shift[1];
        codes[2] += shift[2];
    }
}

/* Factors of the row's prediction: |codes| <= 16383 >> up (checked), so shifted ones are within +-16383 and
 * their products shifted right by 14 within +-16383. */
static void fk_factors(const fk_tables_t *tables, const uint8_t *state, uint32_t factors[FK_COEFFICIENTS / 2U])
{
    const int32_t u0 = fk_read_i16(state) * (int32_t)(1U << tables->up[0]);
    const int32_t u1 = fk_read_i16(state + 2) * (int32_t)(1U << tables->up[1]);
    const int32_t u2 = fk_read_i16(state + 4) * (int32_t)(1U << tables->up[2]);

    factors[0] = fk_pair(16384, u0);
    factors[1] = fk_pair(u1, u2);
    factors[2] = fk_pair((u0 * u0) >> 14, (u0 * u1) >> 14);
    factors[3] = fk_pair((u0 * u2) >> 14, (u1 * u1) >> 14);
    factors[4] = fk_pair((u1 * u2) >> 14, (u2 * u2) >> 14);
}

/* The row to look a velocity up in. Beyond the box of all states and the offset that is corrected for, the table
 * holds no further information, so such a velocity is clamped to that box, axis by axis: a search from far away
 * would visit many rows. The clamped offset from a row is the same either way. */
static uint16_t fk_row_of(const fk_tables_t *tables, const int32_t velocity_code[3])
{
    int32_t codes[3];
    uint32_t axis;

    for (axis = 0U; axis < 3U; axis++) {
        const int32_t least = tables->state_least[axis] - tables->offset_limit[axis];
        const int32_t most = tables->state_most[axis] + tables->offset_limit[axis];
        const int32_t code = velocity_code[axis];

        codes[axis] = (code < least) ? least : ((code > most) ? most : code);
    }
    return fk_nearest(tables, codes);
}

void fk_lookup(const fk_tables_t *tables, const fk_dynamics_t *from, fk_lookup_t *lookup)
{
    const uint32_t row = fk_row_of(tables, from->velocity_code);
    const uint8_t *state = tables->state_rows + 6U * row;
    uint32_t index;

    lookup->row = (uint16_t)row; /* < states <= 65535 */
    /* Widest offset: 65534 rows x 1536 bytes, within uint32_t. */
    lookup->residuals = tables->transition_rows + row * tables->row_bytes;
    if (tables->kind == FK_KIND_NEAREST) {
        /* Block i holds rows [(i n) >> b, ((i + 1) n) >> b). Widest: 65535 << 8, within uint32_t. */
        const uint32_t block = (((row + 1U) << tables->block_levels) - 1U) / tables->states;
        lookup->model = tables->models + 12U * FK_COEFFICIENTS * tables->actions * block;
        fk_factors(tables, state, lookup->factors);
        return;
    }
    lookup->model = NULL;
    for (index = 0U; index < 3U; index++) {
        const int32_t offset = from->velocity_code[index] - fk_read_i16(state + 2U * index);
        lookup->offset[index] = fk_clamp(offset, tables->offset_limit[index]);
    }
    for (index = 0U; index < FK_LIMBS_MAX / 2U; index++) {
        lookup->factors[index] = fk_pair(from->limb_use[2U * index], from->limb_use[2U * index + 1U]);
    }
}

void fk_lookup_motion(const fk_tables_t *tables, const fk_lookup_t *lookup, const fk_dynamics_t *from,
                      uint32_t action, fk_motion_t *motion)
{
    int32_t codes[3];

    (void)from; /* fk_lookup() has used it; the interface allows for a kind of table that needs it here */
    fk_decode(tables, lookup, action, 0U, codes);
    motion->forward_m = (float)fk_clamp(codes[0], tables->motion_limit[0]) * tables->motion_scale[0];
    motion->left_m = (float)fk_clamp(codes[1], tables->motion_limit[1]) * tables->motion_scale[1];
    motion->turn_rad = (float)fk_clamp(codes[2], tables->motion_limit[2]) * tables->motion_scale[2];
}

void fk_lookup_next(const fk_tables_t *tables, const fk_lookup_t *lookup, const fk_dynamics_t *from,
                    uint32_t action, fk_dynamics_t *next)
{
    int32_t codes[3];
    uint32_t index;

    fk_decode(tables, lookup, action, 3U, codes);
    for (index = 0U; index < 3U; index++) {
        next->velocity_code[index] = fk_clamp(codes[index], FK_VELOCITY_CODE_MAX);
    }
    fk_limb_use_after(tables, from->limb_use, action, next->limb_use);
}

void fk_limb_use_after(const fk_tables_t *tables, const uint16_t *use, uint32_t action, uint16_t *next)
{
    const uint8_t *row = tables->action_rows + 4U * action;
    const uint32_t fires = (uint32_t)row[1] | (uint32_t)row[2];
    uint32_t limb;

    for (limb = 0U; limb < FK_LIMBS_MAX; limb++) {
        uint32_t used = 0U;
        if (limb < tables->limbs) {
            used = ((uint32_t)use[limb] * tables->use_decay) >> 15; /* < 65536 * 32768 */
            if (((fires >> limb) & 1U) != 0U) {
                used += tables->use_gain;
            }
        }
        next[limb] = (uint16_t)((used > FK_LIMB_USE_MAX) ? FK_LIMB_USE_MAX : used);
    }
}
