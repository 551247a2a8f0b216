/* wear.c - how worn limbs change the prediction: the image's wear curves, and from them one shift for each action.
 *
 * Widths: a knot is within +-32767 (fk_image_check), so the step between two is within +-65534 and its product with a
 * part below 2^15 below 2^31. A sum over the limbs is within +-2^18. */
#include "fk_internal.h"

void fk_wear_curve(const fk_tables_t *tables, uint32_t limb, uint32_t lost, int32_t codes[6])
{
    const uint32_t knots = tables->wear_knots;
    const uint32_t place = lost * knots; /* position along the curve in knots, times 2^15 */
    const uint32_t knot = place >> 15;   /* < knots, as lost < 2^15 */
    const int32_t part = (int32_t)(place & 0x7FFFU);
    const uint8_t *after = tables->wear_curves + 12U * (limb * knots + knot);
    uint32_t value;

    for (value = 0U; value < 6U; value++) {
        const int32_t from = (knot > 0U) ? fk_read_i16(after + 2U * value - 12U) : 0;
        const int32_t step = fk_read_i16(after + 2U * value) - from;
        codes[value] = from + ((step * part) >> 15); /* arithmetic, as in lookup.c */
    }
}

void fk_wear_shift(const fk_tables_t *tables, const uint16_t lost[FK_LIMBS_MAX], int16_t *shift)
{
    int32_t codes[FK_LIMBS_MAX][6];
    uint32_t limb;
    uint32_t action;
    uint32_t value;

    for (limb = 0U; limb < tables->limbs; limb++) {
        fk_wear_curve(tables, limb, lost[limb], codes[limb]);
    }
    for (action = 0U; action < tables->actions; action++) {
        const uint8_t *row = tables->action_rows + 4U * action;
        const uint32_t fires = (uint32_t)row[1] | (uint32_t)row[2];
        for (value = 0U; value < 6U; value++) {
            int32_t sum = 0;
            for (limb = 0U; limb < tables->limbs; limb++) {
                if (((fires >> limb) & 1U) != 0U) {
                    sum += codes[limb][value];
                }
            }
            sum = (sum > INT16_MAX) ? INT16_MAX : sum;
            *shift = (int16_t)((sum < -INT16_MAX) ? -INT16_MAX : sum);
            shift++;
        }
    }
}
