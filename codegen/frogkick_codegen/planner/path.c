/* path.c - the path's points: checks, and the nearest one. */
#include "fk_internal.h"

/* Bits of |values| order like integers, infinity and NaN above every limit; twice them leaves the sign out. */
static uint32_t fk_twice_magnitude(float value)
{
    return fk_bits_of_float(value) << 1;
}

int32_t fk_path_check(const fk_path_t *path)
{
    const uint32_t position_limit = fk_twice_magnitude(FK_POSITION_MAX_M);
    const uint32_t tangent_limit = fk_twice_magnitude(FK_HEADING_MAX_RAD);
    uint32_t index;

    if (path == NULL) {
        return FK_ERROR_NULL;
    }
    if ((path->count < 2U) || (path->count > FK_PATH_POINTS_MAX)) {
        return FK_ERROR_PATH_COUNT;
    }
    for (index = 0U; index < path->count; index++) {
        if (FK_SELDOM(fk_twice_magnitude(path->x_m[index]) > position_limit)
            || FK_SELDOM(fk_twice_magnitude(path->y_m[index]) > position_limit)
            || FK_SELDOM(fk_twice_magnitude(path->tangent_rad[index]) > tangent_limit)) {
            return FK_ERROR_PATH_POINT;
        }
    }
    return FK_OK;
}

uint16_t fk_path_nearest(const fk_path_t *path, float x_m, float y_m, float *distance2_m2)
{
    const float *points_x_m = path->x_m;
    const float *points_y_m = path->y_m;
    const uint32_t count = path->count;
    float best_m2 = FLT_MAX; /* positions are within 1000 m plus four motions, so squares stay below 1e9 */
    uint32_t best_index = 0U;
    uint32_t index;

    for (index = 0U; index < count; index++) {
        const float dx_m = points_x_m[index] - x_m;
        const float dy_m = points_y_m[index] - y_m;
        const float distance2 = dx_m * dx_m + dy_m * dy_m;
        if (distance2 < best_m2) { /* strictly: the lowest index keeps a tie */
            best_m2 = distance2;
            best_index = index;
        }
    }
    if (distance2_m2 != NULL) {
        *distance2_m2 = best_m2;
    }
    return (uint16_t)best_index; /* < FK_PATH_POINTS_MAX */
}
