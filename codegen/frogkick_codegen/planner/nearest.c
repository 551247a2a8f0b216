/* nearest.c - the table row nearest to a velocity, exactly, over an implicit k-d tree.
 *
 * Metric: squared difference of codes, summed over the three axes. Widths: codes are within +-16383, so a
 * difference is within +-32766; its square is at most 1 073 610 756 < 2^31, so it fits int32_t; the sum of
 * three is at most 3 220 832 268 < 2^32, so it fits uint32_t. Nothing overflows, nothing is rounded. */
#include "fk_internal.h"

/* A tree of 65535 rows has 16 levels (2^16 - 1 rows fill them), and a search keeps at most one postponed
 * side for each level. */
#define FK_KD_LEVELS_MAX 16U

typedef struct {
    uint32_t plane_distance2; /* codes^2 from the query to the plane that splits this side off */
    uint16_t low;             /* first row of the side */
    uint16_t high;            /* one past its last row */
    uint32_t axis;            /* axis that splits it: 0, 1, 2 */
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
    fk_side_t sides[FK_KD_LEVELS_MAX];
    uint32_t waiting = 0U;
    uint32_t low = 0U;
    uint32_t high = tables->states;
    uint32_t axis = 0U;
    uint32_t best_row = 0U;
    uint32_t best_distance2 = UINT32_MAX; /* above every distance, so the first row replaces it */

    for (;;) {
        while (low < high) {
            const uint32_t middle = low + (high - low) / 2U;
            const uint8_t *row = tables->state_rows + 6U * middle;
            int32_t difference[3];
            uint32_t distance2;
            uint32_t plane_distance2;
            uint32_t next_axis = (axis == 2U) ? 0U : axis + 1U;

            difference[0] = codes[0] - fk_read_i16(row);
            difference[1] = codes[1] - fk_read_i16(row + 2);
            difference[2] = codes[2] - fk_read_i16(row + 4);
            distance2 = (uint32_t)(difference[0] * difference[0]) + (uint32_t)(difference[1] * difference[1])
                      + (uint32_t)(difference[2] * difference[2]);
            if ((distance2 < best_distance2) || ((distance2 == best_distance2) && (middle < best_row))) {
                best_distance2 = distance2;
                best_row = middle;
            }
            plane_distance2 = (uint32_t)(difference[axis] * difference[axis]);
            /* Near side first; the far side waits. Every row there is at least as far as the plane, so a
             * side at exactly the best distance may still hold an equal row with a lower index. */
            if (plane_distance2 <= best_distance2) {
                fk_side_t *side = &sides[waiting];
                side->plane_distance2 = plane_distance2;
                side->axis = next_axis;
                if (difference[axis] < 0) {
                    side->low = (uint16_t)(middle + 1U); /* <= high <= 65535 */
                    side->high = (uint16_t)high;
                } else {
                    side->low = (uint16_t)low;
                    side->high = (uint16_t)middle;
                }
                waiting += 1U;
            }
            if (difference[axis] < 0) {
                high = middle;
            } else {
                low = middle + 1U;
            }
            axis = next_axis;
        }
        do {
            if (waiting == 0U) {
                return (uint16_t)best_row; /* < states <= 65535 */
            }
            waiting -= 1U;
        } while (sides[waiting].plane_distance2 > best_distance2);
        low = sides[waiting].low;
        high = sides[waiting].high;
        axis = sides[waiting].axis;
    }
}
