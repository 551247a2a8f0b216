/* nearest.c - the table row nearest to a velocity, exactly, over an implicit k-d tree.
 *
 * Metric: squared difference of codes, summed over the three axes. Widths: codes and splits are within
 * +-16383, so a difference is within +-32766; its square is at most 1 073 610 756 < 2^31, so it fits int32_t;
 * the sum of three is at most 3 220 832 268 < 2^32, so it fits uint32_t. No distance to a row overflows or is
 * rounded. */
#include "fk_internal.h"

/* A side of a split that is still to be searched, with the squared distance along each axis from the query to its
 * box. */
typedef struct {
    uint32_t box_distance2; /* codes^2, sum of the three: no row of the side is nearer */
    uint32_t apart2[3];     /* codes^2 */
    uint32_t axes;          /* of its split and those below, two bits each */
    uint32_t node;          /* heap order, 1 is the root; leaves follow the splits */
} fk_side_t;

int32_t fk_velocity_code(float velocity, float codes_per_velocity)
{
    const float code = velocity * codes_per_velocity; /* may become infinite: clamped below */
    float rest;
    int32_t whole;

    if (code >= (float)FK_VELOCITY_CODE_MAX) {
        return FK_VELOCITY_CODE_MAX;
    }
    if (code <= -(float)FK_VELOCITY_CODE_MAX) {
        return -FK_VELOCITY_CODE_MAX;
    }
    whole = (int32_t)code;      /* towards zero, |code| < 16383 */
    rest = code - (float)whole; /* exact; adding 0.5 before truncating would not be */
    if (rest >= 0.5f) {
        whole += 1;
    } else if (rest <= -0.5f) {
        whole -= 1;
    }
    return whole;
}

uint16_t fk_nearest(const fk_tables_t *tables, const int32_t codes[3])
{
    fk_side_t sides[FK_TREE_LEVELS_MAX + 1U]; /* the root, later at most one for each level */
    const uint32_t levels = tables->tree_levels;
    const uint32_t leaves = 1U << levels;
    const uint32_t states = tables->states;
    uint32_t waiting = 1U;
    uint32_t best_row = 0U;
    uint32_t best_distance2 = UINT32_MAX; /* above every distance, so the first row replaces it */
    uint32_t axis;

    sides[0].box_distance2 = 0U;
    sides[0].axes = tables->axes;
    sides[0].node = 1U;
    for (axis = 0U; axis < 3U; axis++) { /* to the box that holds all states */
        const int32_t below = tables->state_least[axis] - codes[axis];
        const int32_t above = codes[axis] - tables->state_most[axis];
        const int32_t apart = (below > 0) ? below : ((above > 0) ? above : 0);
        sides[0].apart2[axis] = (uint32_t)(apart * apart);
        sides[0].box_distance2 += sides[0].apart2[axis];
    }
    while (waiting > 0U) {
        const fk_side_t *from = &sides[waiting - 1U];
        const uint32_t box_distance2 = from->box_distance2;
        uint32_t apart2[3];
        uint32_t axes;
        uint32_t node;
        uint32_t row;
        uint32_t end;
        const uint8_t *state;

        waiting -= 1U;
        /* A side at exactly the best distance may still hold an equal row with a lower index. */
        if (box_distance2 > best_distance2) {
            continue;
        }
        apart2[0] = from->apart2[0];
        apart2[1] = from->apart2[1];
        apart2[2] = from->apart2[2];
        axes = from->axes;
        node = from->node;
        while (node < leaves) {
            const uint32_t here = axes & 3U; /* 0, 1, 2: checked */
            const int32_t difference = codes[here] - fk_read_i16(tables->splits + 2U * (node - 1U));
            const uint32_t plane2 = (uint32_t)(difference * difference);
            const uint32_t far_distance2 = box_distance2 - apart2[here] + plane2;
            const uint32_t near = (difference < 0) ? 2U * node : 2U * node + 1U;

            axes >>= 2;
            if (far_distance2 <= best_distance2) { /* near side first; the far side waits */
                fk_side_t *side = &sides[waiting];
                side->box_distance2 = far_distance2;
                side->apart2[0] = apart2[0];
                side->apart2[1] = apart2[1];
                side->apart2[2] = apart2[2];
                side->apart2[here] = plane2;
                side->axes = axes;
                side->node = near ^ 1U;
                waiting += 1U;
            }
            node = near;
        }
        /* Leaf i holds rows [(i n) >> levels, ((i + 1) n) >> levels). Widest: 2^13 * 65535 < 2^32. */
        row = ((node - leaves) * states) >> levels;
        end = ((node - leaves + 1U) * states) >> levels;
        /* Two rows are three words, aligned where the image is. The row before the leaf's first or behind its last
         * may come with it: one more candidate, unless it is behind the last of all, where there are bytes enough. */
        row &= ~1U;
        state = tables->state_rows + 6U * row;
        for (; row < end; row += 2U) {
            const uint32_t first = fk_read_u32(state);
            const uint32_t middle = fk_read_u32(state + 4);
            const uint32_t last = fk_read_u32(state + 8);
            const int32_t d0 = fk_low(first) - codes[0];
            const int32_t d1 = fk_high(first) - codes[1];
            const int32_t d2 = fk_low(middle) - codes[2];
            /* Squares modulo 2^32: what is behind the last row may be any number. */
            const uint32_t e0 = (uint32_t)(fk_high(middle) - codes[0]);
            const uint32_t e1 = (uint32_t)(fk_low(last) - codes[1]);
            const uint32_t e2 = (uint32_t)(fk_high(last) - codes[2]);
            const uint32_t distance2 = (uint32_t)(d0 * d0) + (uint32_t)(d1 * d1) + (uint32_t)(d2 * d2);
            const uint32_t other2 = e0 * e0 + e1 * e1 + e2 * e2;

            /* Most rows are further: one comparison for them. */
            if (FK_SELDOM(distance2 <= best_distance2) && ((distance2 != best_distance2) || (row < best_row))) {
                best_distance2 = distance2;
                best_row = row;
            }
            if (FK_SELDOM(other2 <= best_distance2) && ((other2 != best_distance2) || (row + 1U < best_row))
                && (row + 1U < states)) {
                best_distance2 = other2;
                best_row = row + 1U;
            }
            state += 12;
        }
    }
    return (uint16_t)best_row; /* < states <= 65535 */
}
