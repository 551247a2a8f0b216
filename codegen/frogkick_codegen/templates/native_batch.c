/* native_batch.c - flat-array entries to the planner for a host that binds them without its structures.
 * Part of the host's shared library only, never of an emitted directory. */
#include "native_inputs.h"

/* As frogkick.planner.kernel.PLAN_ROW: 92 bytes, every member 4 bytes wide, so without padding. */
typedef struct {
    int32_t status;
    int32_t action;
    int32_t nearest_state;
    int32_t path_index;
    int32_t depth_reached;
    int32_t transitions;
    float cost;
    float distance_m;
    float along_points;
    float predicted[6];
    uint32_t predicted_limb_use[FK_LIMBS_MAX];
} fk_native_row_t;

FK_EXPORT int32_t fk_native_open(const uint8_t *image, uint32_t size);
FK_EXPORT int32_t fk_native_plan_batch(const uint8_t *image, uint32_t size, const float *path, uint32_t points,
                                       const float *weights, uint32_t cost, uint32_t transitions_max,
                                       const float *states, const uint16_t *limb_use, const float *along_points,
                                       const int32_t *depths, const uint16_t *lost, uint32_t count,
                                       fk_native_row_t *rows);
FK_EXPORT void fk_native_sincos(const float *angles_rad, uint32_t count, float *sines, float *cosines);
FK_EXPORT void fk_native_wrap(const float *angles_rad, uint32_t count, float *wrapped_rad);
FK_EXPORT uint32_t fk_native_crc32(uint32_t crc, const uint8_t *bytes, uint32_t length);

int32_t fk_native_open(const uint8_t *image, uint32_t size)
{
    fk_tables_t tables;
    return fk_tables_open(image, size, &tables);
}

/* path: x, y, tangent of `points` points, one after the other. weights: the floats of fk_plan_config_t in its
 * order. limb_use: FK_LIMBS_MAX for each state. lost: FK_LIMBS_MAX for all, or null. rows: zeroed by the caller.
 * Returns what fk_tables_open() returns; each row has the status of its own plan. */
int32_t fk_native_plan_batch(const uint8_t *image, uint32_t size, const float *path, uint32_t points,
                             const float *weights, uint32_t cost, uint32_t transitions_max, const float *states,
                             const uint16_t *limb_use, const float *along_points, const int32_t *depths,
                             const uint16_t *lost, uint32_t count, fk_native_row_t *rows)
{
    fk_tables_t tables;
    int16_t shift[6U * FK_ACTIONS_MAX];
    fk_path_t route;
    fk_plan_config_t config;
    uint32_t index;
    const int32_t error = fk_native_open_worn(image, size, lost, shift, &tables);

    if (error != FK_OK) {
        return error;
    }
    fk_native_path(path, points, &route);
    fk_native_config(weights, cost, transitions_max, &config);
    for (index = 0U; index < count; index++) {
        fk_native_row_t *row = &rows[index];
        fk_state_t state;
        fk_plan_t plan;
        uint32_t limb;

        fk_native_state(states + 6U * index, limb_use + FK_LIMBS_MAX * index, along_points[index], &state);
        config.depth = fk_native_u8((uint32_t)depths[index]); /* below 0 becomes very large */
        row->status = fk_plan(&tables, &route, &config, &state, &plan);
        if (row->status != FK_OK) {
            continue;
        }
        row->action = plan.action;
        row->nearest_state = plan.nearest_state;
        row->path_index = plan.path_index;
        row->depth_reached = plan.depth_reached;
        row->transitions = (int32_t)plan.transitions; /* below 32 + 32^2 + 32^3 + 32^4 */
        row->cost = plan.cost;
        row->distance_m = plan.distance_m;
        row->along_points = plan.along_points;
        row->predicted[0] = plan.predicted.x_m;
        row->predicted[1] = plan.predicted.y_m;
        row->predicted[2] = plan.predicted.heading_rad;
        row->predicted[3] = plan.predicted.vx_mps;
        row->predicted[4] = plan.predicted.vy_mps;
        row->predicted[5] = plan.predicted.omega_rad_s;
        for (limb = 0U; limb < FK_LIMBS_MAX; limb++) {
            row->predicted_limb_use[limb] = plan.predicted.limb_use[limb];
        }
    }
    return FK_OK;
}

void fk_native_sincos(const float *angles_rad, uint32_t count, float *sines, float *cosines)
{
    uint32_t index;

    for (index = 0U; index < count; index++) {
        fk_sincos(angles_rad[index], &sines[index], &cosines[index]);
    }
}

void fk_native_wrap(const float *angles_rad, uint32_t count, float *wrapped_rad)
{
    uint32_t index;

    for (index = 0U; index < count; index++) {
        wrapped_rad[index] = fk_wrap_angle(angles_rad[index]);
    }
}

uint32_t fk_native_crc32(uint32_t crc, const uint8_t *bytes, uint32_t length)
{
    return fk_crc32(crc, bytes, length);
}
