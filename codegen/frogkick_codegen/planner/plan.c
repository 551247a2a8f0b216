/* plan.c - one decision: its inputs checked, its problem set up, the search that answers it, the state that it predicts.
 */
#include "fk_search.h"

/* least: 0 or -most. */
static int32_t fk_is_weight(float value, float least, float most)
{
    const uint32_t bits = fk_bits_of_float(value);
    /* Of a weight -0.0 has the sign bit and is refused like every negative one; NaN lies above the limit. */
    const uint32_t size = (least < 0.0f) ? (bits & FK_FLOAT_MAGNITUDE) : bits;

    return (size <= fk_bits_of_float(most)) ? 1 : 0;
}

static int32_t fk_config_check(const fk_plan_config_t *config)
{
    if ((config->depth < 1U) || (config->depth > FK_DEPTH_MAX)) {
        return FK_ERROR_DEPTH;
    }
    if (config->cost > (uint8_t)FK_COST_LAST) {
        return FK_ERROR_COST;
    }
#define FK_CHECK(name, NAME, least, most) \
    if (fk_is_weight(config->name, least, most) == 0) { \
        return FK_ERROR_WEIGHT; \
    }
    FK_PLAN_WEIGHTS(FK_CHECK)
#undef FK_CHECK
    return FK_OK;
}

static int32_t fk_state_check(const fk_state_t *state, uint32_t points)
{
    uint32_t limb;
    const uint32_t position_limit = fk_bits_of_float(FK_POSITION_MAX_M);
    const uint32_t heading_limit = fk_bits_of_float(FK_HEADING_MAX_RAD);

    if ((fk_float_is_not_finite(state->x_m) != 0) || (fk_float_is_not_finite(state->y_m) != 0)
        || (fk_float_is_not_finite(state->heading_rad) != 0) || (fk_float_is_not_finite(state->vx_mps) != 0)
        || (fk_float_is_not_finite(state->vy_mps) != 0)
        || (fk_float_is_not_finite(state->omega_rad_s) != 0)
        || (fk_float_is_not_finite(state->along_points) != 0)) {
        return FK_ERROR_NOT_FINITE;
    }
    if (((fk_bits_of_float(state->x_m) & FK_FLOAT_MAGNITUDE) > position_limit)
        || ((fk_bits_of_float(state->y_m) & FK_FLOAT_MAGNITUDE) > position_limit)
        || ((fk_bits_of_float(state->heading_rad) & FK_FLOAT_MAGNITUDE) > heading_limit)) {
        return FK_ERROR_RANGE;
    }
    for (limb = 0U; limb < FK_LIMBS_MAX; limb++) {
        if (state->limb_use[limb] > FK_LIMB_USE_MAX) {
            return FK_ERROR_RANGE;
        }
    }
    if (!((state->along_points >= 0.0f) && (state->along_points <= (float)(points - 1U)))) {
        return FK_ERROR_RANGE;
    }
    return FK_OK;
}

/* First actions that are not candidates: with the route cost those that fire no limb, where the robot may not
 * rest, unless the table has no others. */
static uint32_t fk_excluded(const fk_problem_t *problem, const fk_state_t *state)
{
    const uint8_t *row = problem->tables->action_rows; /* name, first mask, second mask, 0 */
    uint32_t excluded = 0U;
    uint32_t firing = 0U;
    uint32_t action;

    if ((problem->config->cost != (uint8_t)FK_COST_ROUTE)
        || (fk_route_may_rest(problem->tables, &problem->route, state) != 0)) {
        return 0U;
    }
    for (action = 0U; action < problem->tables->actions; action++) {
        if (((uint32_t)row[1] | (uint32_t)row[2]) != 0U) {
            firing = 1U;
        } else {
            excluded |= 1U << action; /* < FK_ACTIONS_MAX = 32 */
        }
        row += 4;
    }
    return (firing != 0U) ? excluded : 0U;
}

/* Project the state onto its path: for the plan, and for the search where the cost is the route's. */
static void fk_find_on_path(fk_problem_t *problem, const fk_state_t *state, fk_plan_t *plan)
{
    fk_node_t *root = &problem->root;
    float distance2_m2;

    root->knot = 0U;
    root->arc_m = 0.0f;
    if (problem->config->cost == (uint8_t)FK_COST_ROUTE) {
        const float stroke_max_m = fk_route_stroke_max(problem->tables);
        fk_projection_t projection;

        fk_route_project(problem->path, stroke_max_m, state->along_points, state->x_m, state->y_m, &projection);
        fk_route_lay_out(problem->path, problem->config, stroke_max_m, &projection, &problem->route);
        root->knot = FK_ROUTE_BEHIND;
        root->arc_m = (float)FK_ROUTE_BEHIND * problem->route.step_m;
        distance2_m2 = projection.distance2_m2;
        plan->along_points = (float)projection.segment + projection.fraction;
        plan->path_index = (uint16_t)(projection.segment + (uint32_t)projection.fraction); /* 1: next */
    } else {
        plan->path_index = fk_path_nearest(problem->path, state->x_m, state->y_m, &distance2_m2);
        plan->along_points = (float)plan->path_index;
    }
    plan->distance_m = FK_SQRT(distance2_m2);
}

static void fk_predict(fk_problem_t *problem, fk_plan_t *plan)
{
    const fk_tables_t *tables = problem->tables;
    const fk_node_t *root = &problem->root;
    fk_state_t *predicted = &plan->predicted;
    fk_motion_t motion;
    fk_dynamics_t dynamics;
    uint32_t limb;

    fk_lookup_motion(tables, &root->lookup, &root->dynamics, plan->action, &motion);
    fk_node_move(root, &motion, &predicted->x_m, &predicted->y_m);
    predicted->heading_rad = fk_wrap_angle(root->heading_rad + motion.turn_rad);
    fk_lookup_next(tables, &root->lookup, &root->dynamics, plan->action, &dynamics);
    predicted->vx_mps = (float)dynamics.velocity_code[0] * tables->velocity_scale[0];
    predicted->vy_mps = (float)dynamics.velocity_code[1] * tables->velocity_scale[1];
    predicted->omega_rad_s = (float)dynamics.velocity_code[2] * tables->velocity_scale[2];
    for (limb = 0U; limb < FK_LIMBS_MAX; limb++) {
        predicted->limb_use[limb] = dynamics.limb_use[limb];
    }
    predicted->along_points = plan->along_points;
}

static int32_t fk_plan_check(const fk_path_t *path, const fk_plan_config_t *config, const fk_state_t *state)
{
    int32_t error = fk_config_check(config);

    if (error == FK_OK) {
        error = fk_path_check(path);
    }
    if (error == FK_OK) {
        error = fk_state_check(state, path->count);
    }
    return error;
}

int32_t fk_plan(const fk_tables_t *tables, const fk_path_t *path, const fk_plan_config_t *config,
                const fk_state_t *state, fk_plan_t *plan)
{
    fk_problem_t problem;
    fk_node_t *root = &problem.root;
    uint32_t limb;
    int32_t error;

    if ((tables == NULL) || (path == NULL) || (config == NULL) || (state == NULL) || (plan == NULL)) {
        return FK_ERROR_NULL;
    }
    error = fk_plan_check(path, config, state);
    if (error != FK_OK) {
        return error;
    }
    problem.tables = tables;
    problem.path = path;
    problem.config = config;
    root->dynamics.velocity_code[0] = fk_velocity_code(state->vx_mps, tables->codes_per_velocity[0]);
    root->dynamics.velocity_code[1] = fk_velocity_code(state->vy_mps, tables->codes_per_velocity[1]);
    root->dynamics.velocity_code[2] = fk_velocity_code(state->omega_rad_s, tables->codes_per_velocity[2]);
    for (limb = 0U; limb < FK_LIMBS_MAX; limb++) {
        root->dynamics.limb_use[limb] = state->limb_use[limb];
    }
    root->x_m = state->x_m;
    root->y_m = state->y_m;
    root->heading_rad = fk_wrap_angle(state->heading_rad);
    root->cost = 0.0f;
    fk_node_open(tables, root);
    plan->nearest_state = root->lookup.row;
    fk_find_on_path(&problem, state, plan);
    problem.excluded = fk_excluded(&problem, state);
    if ((config->cost == (uint8_t)FK_COST_ROUTE) && (config->depth >= FK_BEAM_DEPTH)) {
        fk_beam_search(&problem, plan);
    } else {
        fk_tree_search(&problem, plan);
    }
    fk_predict(&problem, plan);
    return FK_OK;
}
