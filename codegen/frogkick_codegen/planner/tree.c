/* tree.c - a depth-limited branch and bound over all sequences of actions, with iterative deepening where the
 * transitions are limited. Each level is searched depth first with an explicit stack. The bound is the cost so
 * far: no cost is negative (Land & Doig 1960; iterative deepening: Korf 1985). */
#include "fk_search.h"

typedef struct {
    const fk_tables_t *tables;
    const fk_path_t *path;
    const fk_plan_config_t *config;
    fk_node_t nodes[FK_DEPTH_MAX - 1U]; /* one for each level below the root; successors of the last level are
                                         * evaluated and not kept */
    const fk_node_t *root;
    const fk_route_t *route;
    float shallow_cost[FK_ACTIONS_MAX]; /* of each action at level 1 */
    float level_factor[FK_DEPTH_MAX];   /* paper: of each level of the search under way */
    float best_cost;                    /* of the search under way */
    uint32_t best_action;
    uint32_t excluded;                  /* bit i: action i is not a candidate for the first action */
    uint32_t transitions;
    uint32_t levels;                    /* of the search under way */
} fk_search_t;

/* Whether a branch that begins with this action and costs at least this much can no longer be the best. Costs are
 * not negative, and rounding never lowers a sum when something not negative is added, so pruning is exact. */
static int32_t fk_is_pruned(const fk_search_t *search, uint32_t first_action, float cost)
{
    return ((cost > search->best_cost) || ((cost == search->best_cost) && (first_action >= search->best_action)))
             ? 1
             : 0;
}

/* Expand a node of a level by one action: 1 where that gives a node at the next level, which is not pruned. */
static int32_t fk_expand(fk_search_t *search, const fk_node_t *node, uint32_t level, uint32_t first_action,
                         uint32_t action)
{
    const fk_route_t *route = search->route;
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
                if (route->wall_weight_per_m > 0.0f) {
                    cost = cost
                         + route->wall_weight_per_m
                               * fk_route_glides_beyond_walls(route, node->x_m, node->y_m, x_m, y_m);
                }
            }
        }
        if (fk_is_pruned(search, first_action, cost) == 0) {
            search->best_cost = cost;
            search->best_action = first_action;
        }
        return 0;
    }
    next = &search->nodes[level]; /* level + 1 < levels <= FK_DEPTH_MAX */
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
    const fk_node_t *node = search->root;
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
        if (fk_expand(search, node, level, order[index], action) != 0) {
            level += 1U;
        }
        while ((level > 0U) && (search->nodes[level - 1U].next_action == actions)) {
            level -= 1U;
        }
        if (level > 0U) {
            action = order[search->nodes[level - 1U].next_action];
            search->nodes[level - 1U].next_action += 1U;
            node = &search->nodes[level - 1U];
            continue;
        }
        node = search->root;
        fk_search_keep(search, order[index], plan);
        index += 1U;
        if (index == firsts) {
            return 0;
        }
        action = order[index];
    }
}

void fk_tree_search(const fk_problem_t *problem, fk_plan_t *plan)
{
    const fk_plan_config_t *config = problem->config;
    const uint32_t actions = problem->tables->actions;
    fk_search_t search;
    uint8_t order[FK_ACTIONS_MAX];
    uint32_t firsts;
    uint32_t levels;
    uint32_t index;
    int32_t is_cut = 0;

    search.tables = problem->tables;
    search.path = problem->path;
    search.config = config;
    search.route = &problem->route;
    search.excluded = problem->excluded;
    search.transitions = 0U;
    search.root = &problem->root;
    plan->cost = FLT_MAX;
    plan->action = 0U;
    plan->depth_reached = 1U;
    for (index = 0U; index < actions; index++) {
        search.shallow_cost[index] = 0.0f; /* equal, so the first level is in the order of their numbers */
    }
    fk_search_begin(&search, 1U);
    firsts = fk_search_order(&search, actions, order);
    (void)fk_search_tree(&search, order, firsts, plan);
    if (config->depth > 1U) {
        for (levels = fk_second_level(config, actions); (levels <= config->depth) && (is_cut == 0); levels++) {
            (void)fk_search_order(&search, plan->action, order);
            fk_search_begin(&search, levels);
            is_cut = fk_search_tree(&search, order, firsts, plan);
            if (is_cut == 0) {
                plan->depth_reached = (uint8_t)levels;
            }
        }
    }
    plan->transitions = search.transitions;
}
