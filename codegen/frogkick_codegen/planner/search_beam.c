/* search_beam.c - a beam search over sequences of actions (Lowerre 1976): of each level the FK_BEAM best branches are
 * carried on. A branch's value is what it would cost if it ended there: its cost so far and the terminal cost. To
 * glide beyond a wall costs the walls' weight at the last level alone, and before that only as much as to be as far
 * beside the route: the robot can still turn away, and strokes that turn it to and fro would be dropped otherwise.
 * All branches that are compared have the same length. Of equal values the lower first action comes first, then the
 * branch that was found first: parents in the order of their values, of each parent the actions by their numbers.
 *
 * As no cost is negative, a branch is dropped as soon as its cost so far is not good enough. The first level is always
 * finished. A level that could go beyond the limit of transitions is not begun. */
#include "fk_search.h"

/* A state of the beam, small: all but its look-up. */
typedef struct {
    float x_m;
    float y_m;
    float heading_rad;
    float cost; /* so far */
    float arc_m;
    int16_t velocity_code[3];
    uint16_t limb_use[FK_LIMBS_MAX];
    uint8_t knot;
    uint8_t first_action;
} fk_branch_t;

/* The best branches of a level. */
typedef struct {
    fk_branch_t branches[FK_BEAM];
    float value[FK_BEAM];   /* of each branch */
    uint8_t order[FK_BEAM]; /* places in branches, the best first */
    uint32_t count;
    uint32_t room; /* how many are kept, at most FK_BEAM */
    int32_t is_last;
} fk_beam_t;

/* Whether a branch of at least this value is among the best so far. */
static inline int32_t fk_beam_takes(const fk_beam_t *beam, float value, uint32_t first_action)
{
    uint32_t worst;

    if (beam->count < beam->room) {
        return 1;
    }
    worst = beam->order[beam->count - 1U];
    return ((value < beam->value[worst])
            || ((value == beam->value[worst]) && (first_action < beam->branches[worst].first_action)))
             ? 1
             : 0;
}

/* Make a place for a branch that is among the best, in their order: the worst one's where all are taken. */
static fk_branch_t *fk_beam_place(fk_beam_t *beam, float value, uint32_t first_action)
{
    uint32_t place;
    uint32_t slot;

    if (beam->count < beam->room) {
        slot = beam->count;
        beam->count += 1U;
    } else {
        slot = beam->order[beam->count - 1U];
    }
    for (place = beam->count - 1U; place > 0U; place--) {
        const uint32_t before = beam->order[place - 1U];

        if ((value > beam->value[before])
            || ((value == beam->value[before]) && (first_action >= beam->branches[before].first_action))) {
            break;
        }
        beam->order[place] = (uint8_t)before; /* < FK_BEAM */
    }
    beam->order[place] = (uint8_t)slot;
    beam->value[slot] = value;
    beam->branches[slot].first_action = (uint8_t)first_action;
    return &beam->branches[slot];
}

static void fk_branch_open(const fk_tables_t *tables, const fk_branch_t *branch, fk_node_t *node)
{
    uint32_t index;

    node->x_m = branch->x_m;
    node->y_m = branch->y_m;
    node->heading_rad = branch->heading_rad;
    node->cost = branch->cost;
    node->arc_m = branch->arc_m;
    node->knot = branch->knot;
    for (index = 0U; index < 3U; index++) {
        node->dynamics.velocity_code[index] = branch->velocity_code[index];
    }
    for (index = 0U; index < FK_LIMBS_MAX; index++) {
        node->dynamics.limb_use[index] = branch->limb_use[index];
    }
    fk_node_open(tables, node);
}

/* Expand a node by one action, into the beam if it is among the best there. */
static inline void fk_branch_expand(const fk_problem_t *problem, const fk_node_t *node, uint32_t action,
                                    uint32_t first_action, fk_beam_t *beam)
{
    const fk_route_t *route = &problem->route;
    fk_branch_t *branch;
    fk_dynamics_t dynamics;
    fk_motion_t motion;
    float x_m;
    float y_m;
    float course_x;
    float course_y;
    float cost;
    float value;
    float arc_m;
    uint32_t knot;
    uint32_t index;

    fk_lookup_motion(problem->tables, &node->lookup, &node->dynamics, action, &motion);
    fk_node_move(node, &motion, &x_m, &y_m);
    cost = node->cost + fk_route_motion_cost(route, node->knot, node->arc_m, x_m, y_m, &knot, &arc_m);
    if (fk_beam_takes(beam, cost, first_action) == 0) { /* no terminal cost is negative */
        return;
    }
    fk_route_course(route, node->cosine, node->sine, &motion, &course_x, &course_y);
    value = cost + fk_route_end_cost(route, arc_m, x_m, y_m, course_x, course_y);
    if (fk_beam_takes(beam, value, first_action) == 0) {
        return;
    }
    value = value + fk_route_glide_cost(route, knot, arc_m, node->x_m, node->y_m, x_m, y_m, motion.turn_rad);
    if (route->wall_weight_per_m > 0.0f) {
        value = value
              + ((beam->is_last != 0) ? route->wall_weight_per_m : route->distance_weight_per_m)
                    * fk_route_glides_beyond_walls(route, node->x_m, node->y_m, x_m, y_m);
    }
    if (fk_beam_takes(beam, value, first_action) == 0) {
        return;
    }
    branch = fk_beam_place(beam, value, first_action);
    branch->x_m = x_m;
    branch->y_m = y_m;
    branch->heading_rad = fk_wrap_angle(node->heading_rad + motion.turn_rad);
    branch->cost = cost;
    branch->arc_m = arc_m;
    branch->knot = (uint8_t)knot; /* < FK_ROUTE_KNOTS_MAX */
    fk_lookup_next(problem->tables, &node->lookup, &node->dynamics, action, &dynamics);
    for (index = 0U; index < 3U; index++) {
        branch->velocity_code[index] = (int16_t)dynamics.velocity_code[index]; /* |code| <= FK_VELOCITY_CODE_MAX */
    }
    for (index = 0U; index < FK_LIMBS_MAX; index++) {
        branch->limb_use[index] = dynamics.limb_use[index];
    }
}

FK_CACHE_ALIGNED void fk_beam_search(const fk_problem_t *problem, fk_plan_t *plan)
{
    const uint32_t actions = problem->tables->actions;
    const uint32_t limit = problem->config->transitions_max;
    const uint32_t levels = problem->config->depth + FK_BEAM_BEYOND;
    uint32_t excluded = problem->excluded;
    uint32_t parents = 1U; /* the root */
    fk_node_t node;
    fk_beam_t beams[2];
    uint32_t level;

    plan->transitions = 0U;
    for (level = 0U; level < levels; level++) {
        const fk_beam_t *from = &beams[level & 1U];
        fk_beam_t *to = &beams[(level & 1U) ^ 1U];
        uint32_t parent;
        uint32_t action;

        if ((level > 0U) && (limit != 0U) && (plan->transitions + parents * actions > limit)) {
            break;
        }
        to->count = 0U;
        to->is_last = (level + 1U == levels) ? 1 : 0;
        to->room = (to->is_last != 0) ? 1U : FK_BEAM;
        for (parent = 0U; parent < parents; parent++) {
            const fk_node_t *from_node = &problem->root;
            uint32_t first_action = 0U;

            if (level > 0U) {
                const fk_branch_t *branch = &from->branches[from->order[parent]];

                first_action = branch->first_action;
                fk_branch_open(problem->tables, branch, &node);
                from_node = &node;
            }
            for (action = 0U; action < actions; action++) {
                if (((excluded >> action) & 1U) == 0U) {
                    plan->transitions += 1U;
                    fk_branch_expand(problem, from_node, action, (level > 0U) ? first_action : action, to);
                }
            }
        }
        plan->action = to->branches[to->order[0]].first_action;
        plan->cost = to->value[to->order[0]];
        parents = to->count;
        excluded = 0U;
    }
    plan->depth_reached = (uint8_t)level; /* at most FK_DEPTH_MAX + FK_BEAM_BEYOND */
}
