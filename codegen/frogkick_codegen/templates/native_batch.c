/* native_batch.c - flat-array entries to the planner for a host that binds them without its structures.
 * Part of the host's shared library only, never of an emitted directory. */
#include "fk_planner.h"

#if defined(_WIN32)
#define FK_EXPORT __declspec(dllexport)
#else
#define FK_EXPORT __attribute__((visibility("default")))
#endif

/* As frogkick.planner.plan.PLAN_ROW: 44 bytes, every member 4 bytes wide, so without padding. */
typedef struct {
    int32_t status;
    int32_t action;
    int32_t nearest_state;
    int32_t path_index;
    float cost;
    float predicted[6];
} fk_native_row_t;

FK_EXPORT uint32_t fk_native_row_bytes(void);
FK_EXPORT int32_t fk_native_open(const uint8_t *image, uint32_t size);
FK_EXPORT int32_t fk_native_plan_batch(const uint8_t *image, uint32_t size, const float *path, uint32_t points,
                                       const float *weights, const float *states, const int32_t *depths,
                                       uint32_t count, fk_native_row_t *rows);
FK_EXPORT void fk_native_sincos(const float *angles_rad, uint32_t count, float *sines, float *cosines);
FK_EXPORT void fk_native_wrap(const float *angles_rad, uint32_t count, float *wrapped_rad);
FK_EXPORT uint32_t fk_native_crc32(uint32_t crc, const uint8_t *bytes, uint32_t length);

uint32_t fk_native_row_bytes(void)
{
    return (uint32_t)sizeof(fk_native_row_t);
}

int32_t fk_native_open(const uint8_t *image, uint32_t size)
{
    fk_tables_t tables;
    return fk_tables_open(image, size, &tables);
}

/* path: x, y, tangent of `points` points, one after the other. rows: zeroed by the caller.
 * Returns what fk_tables_open() returns; each row has the status of its own plan. */
int32_t fk_native_plan_batch(const uint8_t *image, uint32_t size, const float *path, uint32_t points,
                             const float *weights, const float *states, const int32_t *depths, uint32_t count,
                             fk_native_row_t *rows)
{
    fk_tables_t tables;
    fk_path_t route;
    fk_plan_config_t config;
    uint32_t index;
    const int32_t error = fk_tables_open(image, size, &tables);

    if (error != FK_OK) {
        return error;
    }
    /* A count beyond 16 bits must not wrap to a valid one. */
    route.count = (points > UINT16_MAX) ? (uint16_t)UINT16_MAX : (uint16_t)points;
    for (index = 0U; (index < points) && (index < FK_PATH_POINTS_MAX); index++) {
        route.x_m[index] = path[index];
        route.y_m[index] = path[points + index];
        route.tangent_rad[index] = path[2U * points + index];
    }
    config.distance_weight_per_m = weights[0];
    config.angle_weight_per_rad = weights[1];
    config.progress_weight = weights[2];
    config.level_weight = weights[3];
    for (index = 0U; index < count; index++) {
        const float *values = states + 6U * index;
        fk_native_row_t *row = &rows[index];
        fk_state_t state;
        fk_plan_t plan;

        state.x_m = values[0];
        state.y_m = values[1];
        state.heading_rad = values[2];
        state.vx_mps = values[3];
        state.vy_mps = values[4];
        state.omega_rad_s = values[5];
        /* Likewise for a depth beyond 8 bits. */
        config.depth = ((depths[index] < 0) || (depths[index] > 255)) ? (uint8_t)255U : (uint8_t)depths[index];
        row->status = fk_plan(&tables, &route, &config, &state, &plan);
        if (row->status != FK_OK) {
            continue;
        }
        row->action = plan.action;
        row->nearest_state = plan.nearest_state;
        row->path_index = plan.path_index;
        row->cost = plan.cost;
        row->predicted[0] = plan.predicted.x_m;
        row->predicted[1] = plan.predicted.y_m;
        row->predicted[2] = plan.predicted.heading_rad;
        row->predicted[3] = plan.predicted.vx_mps;
        row->predicted[4] = plan.predicted.vy_mps;
        row->predicted[5] = plan.predicted.omega_rad_s;
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
