/* Tests only: table images that somebody has changed at random and sealed again. Whatever fk_tables_open() accepts, the
 * planner plans with, from any state that it accepts; built with sanitizers.
 *   hostile_images SEED IMAGES IMAGE...
 * prints how many images were accepted and how many plans were made of them; ends with 1 where a plan is none. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fk_internal.h"

#define BASES_MAX 16
#define PLANS_EACH 3

static uint64_t seed;

static uint32_t below(uint32_t limit) /* xorshift64 */
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (uint32_t)(seed >> 32) % limit;
}

static float share(void) { return (float)below(1001u) * 1e-3f; }

/* From -most to most; often an end, nothing, or a subnormal. */
static float within(float most)
{
    const float ends[4] = {-most, most, 0.0f, 1e-45f};
    return (below(2u) == 0u) ? ends[below(4u)] : (2.0f * share() - 1.0f) * most;
}

static void change(uint8_t *image, uint32_t size)
{
    static const uint8_t edges[] = {0u, 1u, 2u, 14u, 15u, 16u, 127u, 128u, 255u};
    static const uint16_t widest[3] = {FK_MOTION_CODE_MAX, FK_MOTION_CODE_MAX, FK_MOTION_CODE_MAX};
    static const uint16_t furthest[3] = {FK_VELOCITY_CODE_MAX, FK_VELOCITY_CODE_MAX, FK_VELOCITY_CODE_MAX};
    static const float longest = FK_SCALE_MAX;
    const uint32_t transitions_at = fk_read_u32(image + 84);
    const uint32_t states = fk_read_u16(image + 72);
    for (uint32_t changes = below(10u); changes > 0u; --changes) {
        const uint32_t at = (below(3u) == 0u) ? 4u + below(FK_IMAGE_HEADER_BYTES - 4u)
                                              : FK_IMAGE_HEADER_BYTES + below(size - FK_IMAGE_HEADER_BYTES);
        image[at] = (below(2u) == 0u) ? edges[below(sizeof(edges))] : (uint8_t)below(256u);
    }
    if (below(3u) == 0u) { /* residuals as large as they can be */
        for (uint32_t at = transitions_at; at < size; ++at) {
            image[at] = (below(4u) == 0u) ? (uint8_t)below(256u) : 255u;
        }
    }
    if (below(3u) == 0u) {
        memcpy(image + 132, widest, sizeof(widest));
    }
    if (below(3u) == 0u && image[6] == FK_KIND_AFFINE) {
        memcpy(image + 138, furthest, sizeof(furthest));
    }
    for (uint32_t axis = 0u; axis < 6u; ++axis) {
        if (below(4u) == 0u) {
            memcpy(image + 88u + 4u * axis, &longest, sizeof(longest));
        }
    }
    const uint64_t end = (uint64_t)transitions_at + (uint64_t)fk_read_u16(image + 128) * states;
    if (end < size) {
        memset(image + end, 0, size - (size_t)end);
    }
    const uint32_t crc = fk_crc32(0u, image + 16, size - 16u);
    memcpy(image + 12, &crc, sizeof(crc));
}

static void make_path(fk_path_t *path)
{
    const float size_m = (below(2u) == 0u) ? FK_POSITION_MAX_M : 0.5f;
    const uint32_t alike = below(4u) == 0u;
    path->count = (uint16_t)(2u + below((below(3u) == 0u) ? 2u : FK_PATH_POINTS_MAX - 1u));
    for (uint32_t i = 0u; i < path->count; ++i) {
        path->x_m[i] = (alike && i > 0u) ? path->x_m[0] : within(size_m);
        path->y_m[i] = (alike && i > 0u) ? path->y_m[0] : within(size_m);
        path->tangent_rad[i] = within(FK_HEADING_MAX_RAD);
    }
}

static void make_config(fk_plan_config_t *config)
{
#define MAKE(name, NAME, least, most) \
    config->name = ((least) < 0.0f) ? within(most) : ((below(2u) == 0u) ? share() : share() * (most));
    FK_PLAN_WEIGHTS(MAKE)
    config->cost = (uint8_t)below(FK_COST_LAST + 1u);
    config->depth = (uint8_t)(1u + below(FK_DEPTH_MAX));
    config->transitions_max = (config->depth > 2u || below(2u) == 0u) ? 1u + below(600u) : 0u;
}

static void make_state(const fk_path_t *path, fk_state_t *state)
{
    const float fast = (below(4u) == 0u) ? FLT_MAX : 1.0f;
    state->x_m = within(FK_POSITION_MAX_M);
    state->y_m = within(FK_POSITION_MAX_M);
    state->heading_rad = within(FK_HEADING_MAX_RAD);
    state->vx_mps = within(fast);
    state->vy_mps = within(fast);
    state->omega_rad_s = within(fast);
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        state->limb_use[limb] = (uint16_t)below(FK_LIMB_USE_MAX + 1u);
    }
    state->along_points = share() * (float)(path->count - 1u);
}

static int32_t is_finite(float value) { return fk_float_is_not_finite(value) == 0; }

static int32_t is_plan(const fk_tables_t *tables, const fk_path_t *path, const fk_plan_config_t *config,
                       const fk_plan_t *plan)
{
    const fk_state_t *then = &plan->predicted;
    return plan->action < tables->actions && plan->nearest_state < tables->states && plan->path_index < path->count &&
           plan->cost >= 0.0f && is_finite(plan->cost) && is_finite(plan->distance_m) && plan->along_points >= 0.0f &&
           plan->along_points <= (float)(path->count - 1u) && is_finite(then->x_m) && is_finite(then->y_m) &&
           is_finite(then->heading_rad) && is_finite(then->vx_mps) && is_finite(then->vy_mps) &&
           is_finite(then->omega_rad_s) &&
           (config->transitions_max == 0u || plan->transitions <= config->transitions_max ||
            plan->transitions <= tables->actions);
}

static int plan_with(fk_tables_t *tables)
{
    int16_t shift[6u * FK_ACTIONS_MAX];
    uint16_t lost[FK_LIMBS_MAX] = {FK_LOST_MAX};
    for (uint32_t plans = 0u; plans < PLANS_EACH; ++plans) {
        fk_path_t path;
        fk_plan_config_t config;
        fk_state_t state;
        fk_plan_t plan;
        make_path(&path);
        make_config(&config);
        make_state(&path, &state);
        if (tables->wear_knots > 0u && below(2u) == 0u) {
            for (uint32_t limb = 1u; limb < tables->limbs; ++limb) {
                lost[limb] = (uint16_t)below(FK_LOST_MAX + 1u);
            }
            fk_wear_shift(tables, lost, shift);
            tables->worn = shift;
        }
        const int32_t error = fk_plan(tables, &path, &config, &state, &plan);
        if (error != FK_OK || !is_plan(tables, &path, &config, &plan)) {
            fprintf(stderr, "fk_error_t %d, action %u, cost %g\n", error, plan.action, (double)plan.cost);
            return 1;
        }
    }
    return 0;
}

int main(int count, char **texts)
{
    uint8_t *bases[BASES_MAX];
    uint32_t sizes[BASES_MAX];
    const uint32_t base_count = (uint32_t)count - 3u;
    const long images = atol(texts[2]);
    long accepted = 0;
    seed = 0x9E3779B97F4A7C15u * (uint64_t)atol(texts[1]);
    for (uint32_t i = 0u; i < base_count; ++i) {
        FILE *file = fopen(texts[3u + i], "rb");
        bases[i] = malloc(65536u);
        sizes[i] = (uint32_t)fread(bases[i], 1u, 65536u, file);
        fclose(file);
    }
    for (long image = 0; image < images; ++image) {
        const uint32_t base = below(base_count);
        uint8_t *changed = malloc(sizes[base]); /* of its own, so that the sanitizer sees what is read beside it */
        fk_tables_t tables;
        memcpy(changed, bases[base], sizes[base]);
        change(changed, sizes[base]);
        if (fk_tables_open(changed, sizes[base], &tables) == FK_OK) {
            ++accepted;
            if (plan_with(&tables) != 0) {
                fprintf(stderr, "image %ld, changed from %s\n", image, texts[3u + base]);
                return 1;
            }
        }
        free(changed);
    }
    for (uint32_t i = 0u; i < base_count; ++i) {
        free(bases[i]);
    }
    printf("%ld %ld\n", accepted, PLANS_EACH * accepted);
    return 0;
}
