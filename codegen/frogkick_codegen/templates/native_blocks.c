/* native_blocks.c - plans from many states and counts how often each basic block of the planner runs for each.
 * Part of a shared library of the host only, built with -fsanitize-coverage=trace-pc-guard: the compiler then calls
 * the two functions below, at the library's start and in every block. */
#include "native_inputs.h"

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
    fk_native_path(path, points, &route);
    fk_native_config(weights, cost, transitions_max, &config);
    config.depth = fk_native_u8(depth);
    for (index = 0U; index < count; index++) {
        fk_state_t state;
        fk_plan_t plan;
        uint32_t place;

        fk_native_state(states + 6U * index, limb_use + FK_LIMBS_MAX * index, along_points[index], &state);
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
