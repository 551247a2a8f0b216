/* fk_search.h - what the planner's two searches share: a decision's problem, and a state of the search. */
#ifndef FK_SEARCH_H
#define FK_SEARCH_H

#include "fk_route.h"

/* A node of a search: world pose, table row of its velocity, cost so far. */
typedef struct {
    float x_m;
    float y_m;
    float heading_rad;    /* wrapped */
    float sine;           /* of the heading */
    float cosine;
    float cost;           /* sum over the levels above, added from the root */
    float arc_m;          /* arc length along the route, from its first knot */
    uint32_t knot;        /* of the route */
    uint32_t next_action; /* tree search: index in its order of the next action to try */
    fk_dynamics_t dynamics;
    fk_lookup_t lookup;
} fk_node_t;

/* What is to be decided: filled by fk_plan(). */
typedef struct {
    const fk_tables_t *tables;
    const fk_path_t *path;
    const fk_plan_config_t *config;
    uint32_t excluded; /* bit i: action i is not a candidate for the first action */
    fk_node_t root;
    fk_route_t route;  /* route cost */
} fk_problem_t;

/* Choose an action: each fills action, cost, depth_reached and transitions of the plan. tree.c, search_beam.c */
void fk_tree_search(const fk_problem_t *problem, fk_plan_t *plan);
void fk_beam_search(const fk_problem_t *problem, fk_plan_t *plan);

/* Complete a node whose pose and dynamics are set: look them up, and compute the sine of its heading. */
static inline void fk_node_open(const fk_tables_t *tables, fk_node_t *node)
{
    fk_lookup(tables, &node->dynamics, &node->lookup);
    fk_sincos(node->heading_rad, &node->sine, &node->cosine);
    node->next_action = 0U;
}

/* Position after one action: the table's motion, turned from the body into the world. */
static inline void fk_node_move(const fk_node_t *from, const fk_motion_t *motion, float *x_m, float *y_m)
{
    *x_m = from->x_m + (from->cosine * motion->forward_m - from->sine * motion->left_m);
    *y_m = from->y_m + (from->sine * motion->forward_m + from->cosine * motion->left_m);
}

#endif
