/* fk_route.h - the route cost, for the planner's own files: distance and progress along the path as the stage
 * cost, and the robot's course as the terminal cost. route.c explains it. */
#ifndef FK_ROUTE_H
#define FK_ROUTE_H

#include "fk_internal.h"
#include "fk_trig.h"

#define FK_ROUTE_PER_STEP 0.125f  /* step between knots over the table's longest stroke */
#define FK_ROUTE_AHEAD 12U        /* knots that one motion may advance: one and a half of the longest stroke */
#define FK_ROUTE_BEHIND 2U        /* knots behind the one where the route begins */
#define FK_ROUTE_KNOTS_MAX 80U
#define FK_ROUTE_STROKE_MIN_M 1e-4f
#define FK_ROUTE_WALL_PERIODS 4.0f /* a robot that reaches a wall within this many periods at its speed may not rest */
#define FK_ROUTE_SLOW_STEPS 3.0f   /* a robot that moves fewer steps than this in a period is slow, and may not rest */

/* A point of the route and the route's direction there. */
typedef struct {
    float x_m;
    float y_m;
    float direction_x; /* unit vector */
    float direction_y;
} fk_knot_t;

/* A state projected onto its path. */
typedef struct {
    float fraction;          /* of the segment from its point to the next, 0 to 1 */
    float distance2_m2;  /* squared distance of the state from there */
    uint16_t segment;    /* index of its first point */
    uint8_t held;        /* 1: the state is far from the path, and the projection is the one before */
} fk_projection_t;

/* The route and the settings of a search; filled by fk_route_lay_out(). */
typedef struct {
    fk_knot_t knots[FK_ROUTE_KNOTS_MAX];
    float stroke_max_m;
    float step_m;
    float steps_per_m;
    float distance_weight_per_m;
    float angle_weight_per_rad;
    float progress_weight_per_m;
    float look_ahead_m;
    float turn_lead;
    float course_weight_per_m;
    float glide_weight_per_m;
    float glide_lead;
    float wall_weight_per_m;
    float wall_glide;
    float wall_min_m[2]; /* x, y */
    float wall_max_m[2];
    float huber2_m2;         /* square of the distance below which distance is softened */
    float half_per_huber;    /* 1 / m; 0 where nothing is softened */
    float half_huber_m;
    uint32_t last;          /* index of the last knot */
    uint32_t ahead;         /* knots that one motion may advance; 0 where the projection is held */
} fk_route_t;

/* Project a position onto the path, near where it was last (along_points, checked). */
void fk_route_project(const fk_path_t *path, float stroke_max_m, float along_points, float x_m, float y_m,
                      fk_projection_t *projection);

/* Lay out the knots from a projection on, as many as a search to the configured depth needs. */
void fk_route_lay_out(const fk_path_t *path, const fk_plan_config_t *config, float stroke_max_m,
                      const fk_projection_t *projection, fk_route_t *route);

/* 1 where a robot may rest. 0 where it is slow, by FK_ROUTE_SLOW_STEPS. At rest that changes nothing, so it would
 * rest for ever; and beside a path that it cannot follow any stroke costs more than to stay. 0 also where its
 * speed leads it beyond a wall within FK_ROUTE_WALL_PERIODS: it would glide into the wall without turning. */
int32_t fk_route_may_rest(const fk_tables_t *tables, const fk_route_t *route, const fk_state_t *state);

/* Length that scales a route: the table's longest stroke, at least FK_ROUTE_STROKE_MIN_M. */
float fk_route_stroke_max(const fk_tables_t *tables);

static inline float fk_larger(float one, float two)
{
    return (one > two) ? one : two;
}

static inline float fk_smaller(float one, float two)
{
    return (one < two) ? one : two;
}

static inline float fk_knot_distance2(const fk_knot_t *knot, float x_m, float y_m)
{
    const float dx_m = x_m - knot->x_m;
    const float dy_m = y_m - knot->y_m;

    return dx_m * dx_m + dy_m * dy_m;
}

/* The knot nearest to a position among low to high: the nearest of every third one, then of its neighbours. The
 * lowest index keeps a tie. Here and below inline, since a search spends its time in them. */
static inline const fk_knot_t *fk_route_nearest(const fk_route_t *route, uint32_t low, uint32_t high, float x_m,
                                                float y_m, float *distance2_m2)
{
    const fk_knot_t *first = &route->knots[low];
    const fk_knot_t *last = &route->knots[high];
    const fk_knot_t *found = first;
    const fk_knot_t *candidate;
    const fk_knot_t *middle;
    float best_m2 = fk_knot_distance2(first, x_m, y_m);
    float distance2;

    for (candidate = first + 3; candidate <= last; candidate += 3) {
        distance2 = fk_knot_distance2(candidate, x_m, y_m);
        if (distance2 < best_m2) {
            best_m2 = distance2;
            found = candidate;
        }
    }
    middle = found;
    if (middle > first) {
        distance2 = fk_knot_distance2(middle - 1, x_m, y_m);
        if (distance2 <= best_m2) {
            best_m2 = distance2;
            found = middle - 1;
        }
    }
    if (middle < last) {
        distance2 = fk_knot_distance2(middle + 1, x_m, y_m);
        if (distance2 < best_m2) {
            best_m2 = distance2;
            found = middle + 1;
        }
    }
    *distance2_m2 = best_m2;
    return found;
}

/* Huber loss of a distance: by its square near the route, linear beyond. */
static inline float fk_route_huber(const fk_route_t *route, float distance2_m2)
{
    return (distance2_m2 < route->huber2_m2) ? distance2_m2 * route->half_per_huber
                                             : FK_SQRT(distance2_m2) - route->half_huber_m;
}

/* How far a point lies beyond the walls, m. */
float fk_route_beyond_walls(const fk_route_t *route, float x_m, float y_m);

/* Stage cost of a motion that ends at (x_m, y_m), at least 0.
 * knot, arc_m: where on the route it began; *next_knot and *next_arc_m: where it ends. */
static inline float fk_route_motion_cost(const fk_route_t *route, uint32_t knot, float arc_m, float x_m, float y_m,
                                         uint32_t *next_knot, float *next_arc_m)
{
    const uint32_t low = (knot > 0U) ? knot - 1U : 0U;
    const fk_knot_t *found;
    uint32_t high = knot;
    float distance2_m2;
    float along_m;
    float moved_m;
    float shortfall_m;
    float cost;

    if ((route->ahead == 0U) && (high < FK_ROUTE_BEHIND)) {
        high = FK_ROUTE_BEHIND; /* no knot lies behind a held projection */
    }
    high += route->ahead;
    high = (high > route->last) ? route->last : high;
    found = fk_route_nearest(route, low, high, x_m, y_m, &distance2_m2);
    along_m = (x_m - found->x_m) * found->direction_x + (y_m - found->y_m) * found->direction_y;
    moved_m = fk_larger(-route->step_m, fk_smaller(route->step_m, along_m));
    distance2_m2 = fk_larger(0.0f, distance2_m2 - moved_m * (2.0f * along_m - moved_m));
    *next_knot = (uint32_t)(found - route->knots);
    *next_arc_m = (float)*next_knot * route->step_m + moved_m;

    shortfall_m = route->stroke_max_m - fk_smaller(*next_arc_m - arc_m, route->stroke_max_m);
    cost = route->distance_weight_per_m * fk_route_huber(route, distance2_m2) + route->progress_weight_per_m * shortfall_m;
    if (route->wall_weight_per_m > 0.0f) {
        cost = cost + route->wall_weight_per_m * fk_route_beyond_walls(route, x_m, y_m);
    }
    return cost;
}

/* The course after a motion: the heading before it (cosine, sine) plus the weighted motion, turned by the motion's
 * turn and by turn_lead times that again. A vector of any length. */
static inline void fk_route_course(const fk_route_t *route, float cosine, float sine, const fk_motion_t *motion,
                                   float *course_x, float *course_y)
{
    const float ahead = 1.0f + route->course_weight_per_m * motion->forward_m;
    const float aside = route->course_weight_per_m * motion->left_m;
    const float turn_rad = motion->turn_rad + route->turn_lead * motion->turn_rad;
    float turned_sine;
    float turned_cosine;
    float end_sine;
    float end_cosine;

    if ((turn_rad <= FK_SMALL_ANGLE_RAD) && (turn_rad >= -FK_SMALL_ANGLE_RAD)) {
        fk_sincos_small(turn_rad, &turned_sine, &turned_cosine); /* nearly always; the same bits as below */
    } else {
        /* turn_rad <= 983, turn_lead <= 2: within what fk_sincos takes. */
        fk_sincos(fk_wrap_angle(motion->turn_rad) + route->turn_lead * motion->turn_rad, &turned_sine,
                  &turned_cosine);
    }
    end_cosine = cosine * turned_cosine - sine * turned_sine;
    end_sine = sine * turned_cosine + cosine * turned_sine;
    *course_x = end_cosine * ahead - end_sine * aside;
    *course_y = end_sine * ahead + end_cosine * aside;
}

/* Terminal cost, at least 0, of a course that does not lead to the point of the route look_ahead_m beyond arc_m:
 * the weight times 2 sin(angle / 2), which grows with the angle up to half a turn and needs no arc tangent. */
static inline float fk_route_end_cost(const fk_route_t *route, float arc_m, float x_m, float y_m, float course_x,
                                      float course_y)
{
    const float last = (float)route->last;
    const float steps = fk_larger(0.0f, fk_smaller(last, (arc_m + route->look_ahead_m) * route->steps_per_m));
    const uint32_t index = (uint32_t)steps;
    const fk_knot_t *knot = &route->knots[index];
    const float beyond_m = (steps - (float)index) * route->step_m;
    const float dx_m = (knot->x_m + beyond_m * knot->direction_x) - x_m;
    const float dy_m = (knot->y_m + beyond_m * knot->direction_y) - y_m;
    const float square = (dx_m * dx_m + dy_m * dy_m) * (course_x * course_x + course_y * course_y);
    float aligned;

    if (square == 0.0f) {
        return 0.0f;
    }
    aligned = (dx_m * course_x + dy_m * course_y) / FK_SQRT(square);
    return route->angle_weight_per_rad * FK_SQRT(fk_larger(0.0f, 2.0f - 2.0f * aligned));
}

/* Terminal cost, at least 0, of where the robot glides from a branch's end. It glides by glide_lead times its last
 * motion, with the same turn, and its distance from the route there is measured at the knot as far ahead as it
 * glides along the route. */
static inline float fk_route_glide_cost(const fk_route_t *route, uint32_t knot, float arc_m, float from_x_m,
                                        float from_y_m, float x_m, float y_m, float turn_rad)
{
    const fk_knot_t *at = &route->knots[knot];
    const float dx_m = x_m - from_x_m;
    const float dy_m = y_m - from_y_m;
    const float glide_x_m = route->glide_lead * (dx_m - turn_rad * dy_m);
    const float glide_y_m = route->glide_lead * (dy_m + turn_rad * dx_m);
    const float along_m = glide_x_m * at->direction_x + glide_y_m * at->direction_y;
    const float steps = fk_larger(0.0f, fk_smaller((float)route->last, (arc_m + along_m) * route->steps_per_m));
    const fk_knot_t *there = &route->knots[(uint32_t)steps];
    const float across_m = ((y_m + glide_y_m) - there->y_m) * there->direction_x
                         - ((x_m + glide_x_m) - there->x_m) * there->direction_y;

    return route->glide_weight_per_m * fk_route_huber(route, across_m * across_m);
}

/* How far beyond the walls, m, the robot glides to from a motion's end: straight on, by wall_glide times that motion. */
static inline float fk_route_glides_beyond_walls(const fk_route_t *route, float from_x_m, float from_y_m, float x_m,
                                                 float y_m)
{
    return fk_route_beyond_walls(route, x_m + route->wall_glide * (x_m - from_x_m),
                                 y_m + route->wall_glide * (y_m - from_y_m));
}

#endif
