/* native_blocks.c - plans from many states and counts how often each basic block of the planner runs for each.
 * Part of a shared library of the host only, built with -fsanitize-coverage=trace-pc-guard: the compiler then calls
 * the two functions below, at the library's start and in every block. */
#include "fk_planner.h"

#if defined(_WIN32)
#define FK_EXPORT __declspec(dllexport)
#else
#define FK_EXPORT __attribute__((visibility("default")))
#endif

#define FK_BLOCKS_MAX 4096U

void __sanitizer_cov_trace_pc_guard_init(uint32_t *start, uint32_t *stop);
void __sanitizer_cov_trace_pc_guard(uint32_t *guard);
FK_EXPORT uint32_t fk_native_blocks(void);
FK_EXPORT int32_t fk_native_blocks_plan(const uint8_t *image, uint32_t size, const float *path, uint32_t points,
                                        const float *weights, uint32_t cost, uint32_t transitions_max, uint32_t depth,
                                        const float *states, const uint16_t *limb_use, const float *along_points,
                                        uint32_t count, uint32_t *blocks, int32_t *statuses);

static uint32_t fk_block_counts[FK_BLOCKS_MAX];
static uint32_t fk_block_number; /* blocks that have a number */

__attribute__((no_sanitize("coverage"))) void __sanitizer_cov_trace_pc_guard_init(uint32_t *start, uint32_t *stop)
{
    uint32_t *guard;

    for (guard = start; guard < stop; guard++) {
        if (*guard == 0U) { /* a library of several files may be announced more than once */
            fk_block_number += 1U;
            *guard = fk_block_number;
        }
    }
}

__attribute__((no_sanitize("coverage"))) void __sanitizer_cov_trace_pc_guard(uint32_t *guard)
{
    fk_block_counts[*guard % FK_BLOCKS_MAX] += 1U;
}

/* Counts of each state, the first of them of no block; at most FK_BLOCKS_MAX. */
uint32_t fk_native_blocks(void)
{
    return (fk_block_number < FK_BLOCKS_MAX) ? fk_block_number + 1U : FK_BLOCKS_MAX;
}

/* Arguments as fk_native_plan_batch() has them, one depth for all. blocks: count x fk_native_blocks();
 * statuses: count. Returns what fk_tables_open() returns. */
int32_t fk_native_blocks_plan(const uint8_t *image, uint32_t size, const float *path, uint32_t points,
                              const float *weights, uint32_t cost, uint32_t transitions_max, uint32_t depth,
                              const float *states, const uint16_t *limb_use, const float *along_points, uint32_t count,
                              uint32_t *blocks, int32_t *statuses)
{
    fk_tables_t tables;
    fk_path_t route;
    fk_plan_config_t config;
    uint32_t index;
    const uint32_t width = fk_native_blocks();
    const int32_t error = fk_tables_open(image, size, &tables);

    if (error != FK_OK) {
        return error;
    }
    route.count = (uint16_t)points;
    for (index = 0U; (index < points) && (index < FK_PATH_POINTS_MAX); index++) {
        route.x_m[index] = path[index];
        route.y_m[index] = path[points + index];
        route.tangent_rad[index] = path[2U * points + index];
    }
    config.distance_weight_per_m = weights[0];
    config.angle_weight_per_rad = weights[1];
    config.progress_weight = weights[2];
    config.level_weight = weights[3];
    config.progress_weight_per_m = weights[4];
    config.look_ahead_m = weights[5];
    config.soft_distance_m = weights[6];
    config.turn_lead = weights[7];
    config.transitions_max = transitions_max;
    config.cost = (uint8_t)cost;
    config.depth = (uint8_t)depth;
    for (index = 0U; index < count; index++) {
        const float *values = states + 6U * index;
        fk_state_t state;
        fk_plan_t plan;
        uint32_t place;

        state.x_m = values[0];
        state.y_m = values[1];
        state.heading_rad = values[2];
        state.vx_mps = values[3];
        state.vy_mps = values[4];
        state.omega_rad_s = values[5];
        for (place = 0U; place < FK_LIMBS_MAX; place++) {
            state.limb_use[place] = limb_use[FK_LIMBS_MAX * index + place];
        }
        state.along_points = along_points[index];
        for (place = 0U; place < width; place++) {
            fk_block_counts[place] = 0U;
        }
        statuses[index] = fk_plan(&tables, &route, &config, &state, &plan);
        for (place = 0U; place < width; place++) {
            blocks[width * index + place] = fk_block_counts[place];
        }
    }
    return FK_OK;
}
