/* native_inputs.h - the planner's arguments from flat arrays, for the host's shared libraries. */
#ifndef FK_NATIVE_INPUTS_H
#define FK_NATIVE_INPUTS_H

#include "fk_planner.h"

#if defined(_WIN32)
#define FK_EXPORT __declspec(dllexport)
#else
#define FK_EXPORT __attribute__((visibility("default")))
#endif

/* What is too large for a field goes there as its largest number: it must not wrap to a valid one. */
static inline uint8_t fk_native_u8(uint32_t value)
{
    return (value > UINT8_MAX) ? (uint8_t)UINT8_MAX : (uint8_t)value;
}

/* path: x, y, tangent of `points` points, one after the other. */
static inline void fk_native_path(const float *path, uint32_t points, fk_path_t *route)
{
    uint32_t index;

    route->count = (points > UINT16_MAX) ? (uint16_t)UINT16_MAX : (uint16_t)points;
    for (index = 0U; (index < points) && (index < FK_PATH_POINTS_MAX); index++) {
        route->x_m[index] = path[index];
        route->y_m[index] = path[points + index];
        route->tangent_rad[index] = path[2U * points + index];
    }
}

/* weights: the floats of fk_plan_config_t in its order. The depth is the caller's to set. */
static inline void fk_native_config(const float *weights, uint32_t cost, uint32_t transitions_max,
                                    fk_plan_config_t *config)
{
#define FK_TAKE(name, NAME, least, most) config->name = *weights++;
    FK_PLAN_WEIGHTS(FK_TAKE)
#undef FK_TAKE
    config->transitions_max = transitions_max;
    config->cost = fk_native_u8(cost);
}

/* Open an image as a robot has it whose limbs have lost these shares (FK_LIMBS_MAX, null: none) and whose image has
 * curves. shift: 6 x FK_ACTIONS_MAX, which must outlive the table. Returns what fk_tables_open() returns. */
static inline int32_t fk_native_open_worn(const uint8_t *image, uint32_t size, const uint16_t *lost, int16_t *shift,
                                          fk_tables_t *tables)
{
    const int32_t error = fk_tables_open(image, size, tables);

    if ((error == FK_OK) && (lost != 0) && (tables->wear_knots > 0U)) {
        fk_wear_shift(tables, lost, shift);
        tables->worn = shift;
    }
    return error;
}

/* values: the first six floats of fk_state_t in its order. limb_use: FK_LIMBS_MAX. */
static inline void fk_native_state(const float *values, const uint16_t *limb_use, float along_points, fk_state_t *state)
{
    uint32_t limb;

    state->x_m = values[0];
    state->y_m = values[1];
    state->heading_rad = values[2];
    state->vx_mps = values[3];
    state->vy_mps = values[4];
    state->omega_rad_s = values[5];
    for (limb = 0U; limb < FK_LIMBS_MAX; limb++) {
        state->limb_use[limb] = limb_use[limb];
    }
    state->along_points = along_points;
}

#endif
