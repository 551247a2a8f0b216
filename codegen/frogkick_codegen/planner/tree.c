/* tree.c - the search: depth first over sequences of actions, with an explicit stack. */
#include "fk_internal.h"

/* A state on the way down: world pose, table row of its velocity, cost so far. */
typedef struct {
    float x_m;
    float y_m;
    float heading_rad; /* wrapped */
    float sine;        /* of the heading */
    float cosine;
    float cost;             /* sum over the levels above, added from the root */
    const uint8_t *actions; /* the row's transitions, 12 bytes for each action */
    uint32_t next_action;   /* first action not yet tried */
} fk_node_t;

static int32_t fk_config_check(const fk_plan_config_t *config)
{
    const uint32_t limit = fk_bits_of_float(FK_WEIGHT_MAX);

    if ((config->depth < 1U) || (config->depth > FK_DEPTH_MAX)) {
        return FK_ERROR_DEPTH;
    }
    /* -0.0 has the sign bit and is refused like every negative weight; NaN lies above the limit. */
    if ((fk_bits_of_float(config->distance_weight_per_m) > limit)
        || (fk_bits_of_float(config->angle_weight_per_rad) > limit)
        || (fk_bits_of_float(config->progress_weight) > limit)
        || (fk_bits_of_float(config->level_weight) > limit)) {
        return FK_ERROR_WEIGHT;
    }
    return FK_OK;
}

static int32_t fk_state_check(const fk_state_t *state)
{
    const uint32_t position_limit = fk_bits_of_float(FK_POSITION_MAX_M);
    const uint32_t heading_limit = fk_bits_of_float(FK_HEADING_MAX_RAD);

    if ((fk_float_is_not_finite(state->x_m) != 0) || (fk_float_is_not_finite(state->y_m) != 0)
        || (fk_float_is_not_finite(state->heading_rad) != 0) || (fk_float_is_not_finite(state->vx_mps) != 0)
        || (fk_float_is_not_finite(state->vy_mps) != 0)
        || (fk_float_is_not_finite(state->omega_rad_s) != 0)) {
        return FK_ERROR_NOT_FINITE;
    }
    if (((fk_bits_of_float(state->x_m) & FK_FLOAT_MAGNITUDE) > position_limit)
        || ((fk_bits_of_float(state->y_m) & FK_FLOAT_MAGNITUDE) > position_limit)
        || ((fk_bits_of_float(state->heading_rad) & FK_FLOAT_MAGNITUDE) > heading_limit)) {
        return FK_ERROR_RANGE;
    }
    return FK_OK;
}

/* Finish a node whose pose stands: look up its row and its heading's sine. Returns the row. */
static uint16_t fk_node_open(const fk_tables_t *tables, fk_node_t *node, const int32_t codes[3])
{
    const uint16_t row = fk_nearest(tables, codes);

    fk_sincos(node->heading_rad, &node->sine, &node->cosine);
    /* Widest offset: 65534 rows x 32 actions x 12 bytes = 25 165 056, within uint32_t. */
    node->actions = tables->transition_rows + (uint32_t)row * tables->actions * 12U;
    node->next_action = 0U;
    return row;
}

/* Pose after one action: the table's motion, turned from the body into the world. */
static void fk_node_move(const fk_tables_t *tables, const fk_node_t *from, const uint8_t *codes,
                         fk_node_t *to)
{
    const float forward_m = (float)fk_read_i16(codes) * tables->motion_scale[0];
    const float left_m = (float)fk_read_i16(codes + 2) * tables->motion_scale[1];
    const float turn_rad = (float)fk_read_i16(codes + 4) * tables->motion_scale[2];

    to->x_m = from->x_m + (from->cosine * forward_m - from->sine * left_m);
    to->y_m = from->y_m + (from->sine * forward_m + from->cosine * left_m);
    to->heading_rad = fk_wrap_angle(from->heading_rad + turn_rad);
}

int32_t fk_plan(const fk_tables_t *tables, const fk_path_t *path, const fk_plan_config_t *config,
                const fk_state_t *state, fk_plan_t *plan)
{
    /* One more than the levels: the last level's successors are costed in place, never opened. */
    fk_node_t nodes[FK_DEPTH_MAX + 1U];
    float level_factor[FK_DEPTH_MAX];
    int32_t codes[3];
    uint32_t level = 0U;
    uint32_t best_action = 0U;
    float best_cost = FLT_MAX; /* weights <= 1e6 keep every sum below 1e18, so the first branch is less */
    uint32_t index;
    const uint8_t *first;
    int32_t error;

    if ((tables == NULL) || (path == NULL) || (config == NULL) || (state == NULL) || (plan == NULL)) {
        return FK_ERROR_NULL;
    }
    error = fk_config_check(config);
    if (error != FK_OK) {
        return error;
    }
    error = fk_path_check(path);
    if (error != FK_OK) {
        return error;
    }
    error = fk_state_check(state);
    if (error != FK_OK) {
        return error;
    }

    for (index = 0U; index < config->depth; index++) {
        level_factor[index] = 1.0f + config->level_weight * (float)(config->depth - 1U - index);
    }
    codes[0] = fk_velocity_code(state->vx_mps, tables->codes_per_velocity[0]);
    codes[1] = fk_velocity_code(state->vy_mps, tables->codes_per_velocity[1]);
    codes[2] = fk_velocity_code(state->omega_rad_s, tables->codes_per_velocity[2]);
    nodes[0].x_m = state->x_m;
    nodes[0].y_m = state->y_m;
    nodes[0].heading_rad = fk_wrap_angle(state->heading_rad);
    nodes[0].cost = 0.0f;
    plan->nearest_state = fk_node_open(tables, &nodes[0], codes);
    plan->path_index = fk_path_nearest(path, state->x_m, state->y_m, NULL);

    for (;;) {
        fk_node_t *node = &nodes[level];
        fk_node_t *next = &nodes[level + 1U]; /* level < depth <= FK_DEPTH_MAX */
        const uint8_t *transition;

        if (node->next_action == tables->actions) {
            if (level == 0U) {
                break;
            }
            level -= 1U;
            continue;
        }
        transition = node->actions + 12U * node->next_action;
        node->next_action += 1U;
        fk_node_move(tables, node, transition, next);
        next->cost = node->cost
                   + fk_cost(path, config, next->x_m, next->y_m, next->heading_rad) * level_factor[level];
        /* Costs are not negative, so a sum never falls further down: a branch that has reached the best
         * cannot beat it, and an equal one comes later in the order of actions. */
        if (next->cost >= best_cost) {
            continue;
        }
        if (level + 1U == config->depth) {
            best_cost = next->cost;
            best_action = nodes[0].next_action - 1U;
            continue;
        }
        codes[0] = fk_read_i16(transition + 6);
        codes[1] = fk_read_i16(transition + 8);
        codes[2] = fk_read_i16(transition + 10);
        (void)fk_node_open(tables, next, codes);
        level += 1U;
    }

    first = nodes[0].actions + 12U * best_action;
    fk_node_move(tables, &nodes[0], first, &nodes[1]);
    plan->action = (uint8_t)best_action; /* < actions <= 32 */
    plan->cost = best_cost;
    plan->predicted.x_m = nodes[1].x_m;
    plan->predicted.y_m = nodes[1].y_m;
    plan->predicted.heading_rad = nodes[1].heading_rad;
    plan->predicted.vx_mps = (float)fk_read_i16(first + 6) * tables->velocity_scale[0];
    plan->predicted.vy_mps = (float)fk_read_i16(first + 8) * tables->velocity_scale[1];
    plan->predicted.omega_rad_s = (float)fk_read_i16(first + 10) * tables->velocity_scale[2];
    return FK_OK;
}
