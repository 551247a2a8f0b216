/* tree.c - a depth-limited branch and bound over sequences of actions, with iterative deepening where the
 * transitions are limited. Each level is searched depth first with an explicit stack. The bound is the cost so
 * far: no cost is negative (Land & Doig 1960; iterative deepening: Korf 1985). */
#include "fk_route.h"

/* A node of the search: world pose, table row of its velocity, cost so far. */
typedef struct {
    float x_m;
    float y_m;
    float heading_rad;    /* wrapped */
    float sine;           /* of the heading */
    float cosine;
    float cost;           /* sum over the levels above, added from the root */
    float arc_m;          /* arc length along the route, from its first knot */
    uint32_t knot;        /* of the route */
    uint32_t next_action; /* index in the search's order of the next action to try */
    fk_dynamics_t dynamics;
    fk_lookup_t lookup;
} fk_node_t;

typedef struct {
    const fk_tables_t *tables;
    const fk_path_t *path;
    const fk_plan_config_t *config;
    fk_node_t nodes[FK_DEPTH_MAX]; /* one for each level; successors of the last level are evaluated and not kept */
    fk_route_t route;
    float shallow_cost[FK_ACTIONS_MAX]; /* of each action at level 1 */
    float level_factor[FK_DEPTH_MAX];   /* paper: of each level of the search under way */
    float best_cost;                    /* of the search under way */
    uint32_t best_action;
    uint32_t excluded;                  /* bit i: action i is not a candidate for the first action */
    uint32_t transitions;
    uint32_t levels;                    /* of the search under way */
} fk_search_t;

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

/* Complete a node whose pose and dynamics are set: look them up, and compute the sine of its heading. */
static void fk_node_open(const fk_tables_t *tables, fk_node_t *node)
{
    fk_lookup(tables, &node->dynamics, &node->lookup);
    fk_sincos(node->heading_rad, &node->sine, &node->cosine);
    node->next_action = 0U;
}

/* Whether a branch that begins with this action and costs at least this much can no longer be the best. Costs are
 * not negative, and rounding never lowers a sum when something not negative is added, so pruning is exact. */
static int32_t fk_is_pruned(const fk_search_t *search, uint32_t first_action, float cost)
{
    return ((cost > search->best_cost) || ((cost == search->best_cost) && (first_action >= search->best_action)))
             ? 1
             : 0;
}

/* Position after one action: the table's motion, turned from the body into the world. */
static void fk_node_move(const fk_node_t *from, const fk_motion_t *motion, float *x_m, float *y_m)
{
    *x_m = from->x_m + (from->cosine * motion->forward_m - from->sine * motion->left_m);
    *y_m = from->y_m + (from->sine * motion->forward_m + from->cosine * motion->left_m);
}

/* Expand a node by one action: 1 where that gives a node at the next level, which is not pruned. */
static int32_t fk_expand(fk_search_t *search, uint32_t level, uint32_t first_action, uint32_t action)
{
    const fk_node_t *node = &search->nodes[level];
    const fk_route_t *route = &search->route;
    const int32_t is_route = (search->config->cost == (uint8_t)FK_COST_ROUTE) ? 1 : 0;
    fk_node_t *next;
    fk_motion_t motion;
    float x_m;
    float y_m;
    float cost;
    float arc_m = 0.0f;
    uint32_t knot = 0U;

    search->transitions += 1U;
    fk_lookup_motion(search->tables, &node->lookup, &node->dynamics, action, &motion);
    fk_node_move(node, &motion, &x_m, &y_m);
    if (is_route != 0) {
        cost = node->cost + fk_route_motion_cost(route, node->knot, node->arc_m, x_m, y_m, &knot, &arc_m);
    } else {
        cost = node->cost
             + fk_cost(search->path, search->config, x_m, y_m, fk_wrap_angle(node->heading_rad + motion.turn_rad))
                   * search->level_factor[level];
    }
    if (fk_is_pruned(search, first_action, cost) != 0) {
        return 0;
    }
    if (level + 1U == search->levels) {
        if (is_route != 0) {
            float course_x;
            float course_y;

            fk_route_course(route, node->cosine, node->sine, &motion, &course_x, &course_y);
            cost = cost + fk_route_end_cost(route, arc_m, x_m, y_m, course_x, course_y);
            if (fk_is_pruned(search, first_action, cost) == 0) { /* most are, which saves the rest */
                cost = cost + fk_route_glide_cost(route, knot, arc_m, node->x_m, node->y_m, x_m, y_m, motion.turn_rad);
            }
        }
        if (fk_is_pruned(search, first_action, cost) == 0) {
            search->best_cost = cost;
            search->best_action = first_action;
        }
        return 0;
    }
    next = &search->nodes[level + 1U]; /* level + 1 < levels <= FK_DEPTH_MAX */
    next->x_m = x_m;
    next->y_m = y_m;
    next->heading_rad = fk_wrap_angle(node->heading_rad + motion.turn_rad);
    next->cost = cost;
    next->knot = knot;
    next->arc_m = arc_m;
    fk_lookup_next(search->tables, &node->lookup, &node->dynamics, action, &next->dynamics);
    fk_node_open(search->tables, next);
    return 1;
}

static void fk_search_begin(fk_search_t *search, uint32_t levels)
{
    uint32_t index;

    search->levels = levels;
    search->best_cost = FLT_MAX; /* weights <= 1e6 keep every sum below 1e18 */
    search->best_action = search->tables->actions;
    for (index = 0U; index < levels; index++) {
        search->level_factor[index] = 1.0f + search->config->level_weight * (float)(levels - 1U - index);
    }
}

/* First actions that are not candidates: with the route cost those that fire no limb, where the robot may not
 * rest, unless the table has no others. */
static uint32_t fk_excluded(const fk_search_t *search, const fk_state_t *state)
{
    const uint8_t *row = search->tables->action_rows; /* name, first mask, second mask, 0 */
    uint32_t excluded = 0U;
    uint32_t firing = 0U;
    uint32_t action;

    if ((search->config->cost != (uint8_t)FK_COST_ROUTE)
        || (fk_route_may_rest(search->tables, &search->route, state) != 0)) {
        return 0U;
    }
    for (action = 0U; action < search->tables->actions; action++) {
        if (((uint32_t)row[1] | (uint32_t)row[2]) != 0U) {
            firing = 1U;
        } else {
            excluded |= 1U << action; /* < FK_ACTIONS_MAX = 32 */
        }
        row += 4;
    }
    return (firing != 0U) ? excluded : 0U;
}

/* The order in which a deeper level tries the first actions: the best so far, then by their cost at level 1, the
 * lowest on ties. Returns how many there are. Further actions of a branch follow the same order, and those that
 * are not candidates for the first come last. A good branch that is found early prunes more of the later ones. */
static uint32_t fk_search_order(const fk_search_t *search, uint32_t best_action, uint8_t order[FK_ACTIONS_MAX])
{
    uint32_t firsts = 0U;
    uint32_t place;
    uint32_t count;

    for (count = 0U; count < search->tables->actions; count++) {
        place = firsts;
        if (((search->excluded >> count) & 1U) != 0U) {
            continue;
        }
        while ((place > 0U) && (order[place - 1U] != best_action)
               && ((count == best_action) || (search->shallow_cost[count] < search->shallow_cost[order[place - 1U]]))) {
            order[place] = order[place - 1U];
            place -= 1U;
        }
        order[place] = (uint8_t)count; /* < FK_ACTIONS_MAX */
        firsts += 1U;
    }
    place = firsts;
    for (count = 0U; count < search->tables->actions; count++) {
        if (((search->excluded >> count) & 1U) != 0U) {
            order[place] = (uint8_t)count;
            place += 1U;
        }
    }
    return firsts;
}

/* The level to search after the first one: the second, or at once the last where transitions_max cannot end it. */
static uint32_t fk_second_level(const fk_plan_config_t *config, uint32_t actions)
{
    uint32_t most = actions; /* transitions of the first level, and of the whole tree */
    uint32_t width = 1U;
    uint32_t level;

    for (level = 0U; level < config->depth; level++) {
        width *= actions; /* at most 32^4 */
        most += width;
    }
    return ((config->transitions_max == 0U) || (config->transitions_max >= most)) ? config->depth : 2U;
}

/* Note the result of all branches that begin with an action; at level 1 also that action's own cost. */
static void fk_search_keep(fk_search_t *search, uint32_t first_action, fk_plan_t *plan)
{
    if (search->levels > 1U) {
        plan->cost = search->best_cost;
        plan->action = (uint8_t)search->best_action; /* < actions <= FK_ACTIONS_MAX */
        return;
    }
    search->shallow_cost[first_action] = search->best_cost;
    if (search->best_cost < plan->cost) {
        plan->cost = search->best_cost;
        plan->action = (uint8_t)first_action;
    }
    search->best_cost = FLT_MAX;
    search->best_action = search->tables->actions;
}

/* Search the tree, the actions of each level in this order. Returns 1 where transitions_max ends it before its
 * end. Such a level still counts if the first action in order was finished; level 1 is always finished. */
FK_CACHE_ALIGNED static int32_t fk_search_tree(fk_search_t *search, const uint8_t order[FK_ACTIONS_MAX],
                                               uint32_t firsts, fk_plan_t *plan)
{
    const uint32_t limit = (search->levels > 1U) ? search->config->transitions_max : 0U;
    const uint32_t actions = search->tables->actions;
    uint32_t level = 0U;
    uint32_t index = 0U;
    uint32_t action = order[0];

    for (;;) {
        if ((limit != 0U) && (search->transitions >= limit)) {
            if (index > 0U) {
                fk_search_keep(search, order[index], plan);
            }
            return 1;
        }
        if (fk_expand(search, level, order[index], action) != 0) {
            level += 1U;
        }
        while ((level > 0U) && (search->nodes[level].next_action == actions)) {
            level -= 1U;
        }
        if (level > 0U) {
            action = order[search->nodes[level].next_action];
            search->nodes[level].next_action += 1U;
            continue;
        }
        fk_search_keep(search, order[index], plan);
        index += 1U;
        if (index == firsts) {
            return 0;
        }
        action = order[index];
    }
}

/* Iterative deepening: search the first level, then the next ones up to the last. The result goes to plan. */
static void fk_search_levels(fk_search_t *search, fk_plan_t *plan)
{
    const uint32_t actions = search->tables->actions;
    uint8_t order[FK_ACTIONS_MAX];
    uint32_t firsts;
    uint32_t levels;
    uint32_t index;

    plan->cost = FLT_MAX;
    plan->action = 0U;
    plan->depth_reached = 1U;
    for (index = 0U; index < actions; index++) {
        search->shallow_cost[index] = 0.0f; /* equal, so the first level is in the order of their numbers */
    }
    fk_search_begin(search, 1U);
    firsts = fk_search_order(search, actions, order);
    (void)fk_search_tree(search, order, firsts, plan);
    if (search->config->depth == 1U) {
        return;
    }
    for (levels = fk_second_level(search->config, actions); levels <= search->config->depth; levels++) {
        (void)fk_search_order(search, plan->action, order);
        fk_search_begin(search, levels);
        if (fk_search_tree(search, order, firsts, plan) != 0) {
            return;
        }
        plan->depth_reached = (uint8_t)levels;
    }
}

/* Project the state onto its path: for the plan, and for the search where the cost is the route's. */
static void fk_find_on_path(fk_search_t *search, const fk_state_t *state, fk_plan_t *plan)
{
    fk_node_t *root = &search->nodes[0];
    float distance2_m2;

    root->knot = 0U;
    root->arc_m = 0.0f;
    if (search->config->cost == (uint8_t)FK_COST_ROUTE) {
        const float stroke_max_m = fk_route_stroke_max(search->tables);
        fk_projection_t projection;

        fk_route_project(search->path, stroke_max_m, state->along_points, state->x_m, state->y_m, &projection);
        fk_route_lay_out(search->path, search->config, stroke_max_m, &projection, &search->route);
        root->knot = FK_ROUTE_BEHIND;
        root->arc_m = (float)FK_ROUTE_BEHIND * search->route.step_m;
        distance2_m2 = projection.distance2_m2;
        plan->along_points = (float)projection.segment + projection.fraction;
        plan->path_index = (uint16_t)(projection.segment + (uint32_t)projection.fraction); /* 1: next */
    } else {
        plan->path_index = fk_path_nearest(search->path, state->x_m, state->y_m, &distance2_m2);
        plan->along_points = (float)plan->path_index;
    }
    plan->distance_m = FK_SQRT(distance2_m2);
}

static void fk_predict(fk_search_t *search, fk_plan_t *plan)
{
    const fk_tables_t *tables = search->tables;
    const fk_node_t *root = &search->nodes[0];
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
    fk_search_t search;
    fk_node_t *root = &search.nodes[0];
    uint32_t limb;
    int32_t error;

    if ((tables == NULL) || (path == NULL) || (config == NULL) || (state == NULL) || (plan == NULL)) {
        return FK_ERROR_NULL;
    }
    error = fk_plan_check(path, config, state);
    if (error != FK_OK) {
        return error;
    }
    search.tables = tables;
    search.path = path;
    search.config = config;
    search.transitions = 0U;
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
    fk_find_on_path(&search, state, plan);
    search.excluded = fk_excluded(&search, state);
    fk_search_levels(&search, plan);
    plan->transitions = search.transitions;
    fk_predict(&search, plan);
    return FK_OK;
}
