/* route.c - the route cost.
 *
 * The path is a polyline. A state is projected onto it (its nearest point, as an arc length along the path). The
 * projection is carried from decision to decision and looked for only near the last one, so a path that crosses or
 * closes on itself is never left for another part of it. From there knots are laid out at equal steps, straight on
 * beyond both of the path's ends. A pose belongs to the nearest of the knots that one motion can reach, and its
 * deviation from that knot is split along and across the route's direction there.
 *
 * Stage cost: a Huber loss of the motion's end's distance from the route, the shortfall of its advance against the
 * longest stroke of the table and, where there are walls, how far the motion's end lies beyond them. Terminal cost:
 * how far the robot's course leads away from the route's place a look-ahead further on (pure pursuit's target
 * point; the course is the heading and, weighed, the last motion, since a robot with a worn limb goes crabwise);
 * how far beside the route it glides on from the end, by a motion of constant turn; and how far beyond the walls
 * lies the place to which it glides on straight. Each is at least 0, which both searches, tree.c and search_beam.c,
 * rely on. */
#include "fk_route.h"

#define FK_ROUTE_AHEAD_STROKES 1.5f /* the projection is searched for this far ahead along the path */
#define FK_ROUTE_FAR_STROKES 2.0f   /* beyond this distance the projection stays where it was */

float fk_route_stroke_max(const fk_tables_t *tables)
{
    return fk_larger(tables->stroke_max_m, FK_ROUTE_STROKE_MIN_M);
}

/* Projection of a point onto a segment, as a fraction of it: 0 at its first point, 1 at its last. */
static inline float fk_segment_fraction(float dx_m, float dy_m, float length2_m2, float offset_x_m,
                                        float offset_y_m)
{
    const float along_m2 = offset_x_m * dx_m + offset_y_m * dy_m;

    if (along_m2 <= 0.0f) {
        return 0.0f;
    }
    if (along_m2 >= length2_m2) { /* so nothing is divided by 0 either */
        return 1.0f;
    }
    return along_m2 / length2_m2;
}

/* Project onto one segment; keep that if it is nearer than what was found, or as near and wins ties. Returns the
 * segment's length. */
static inline float fk_project_segment(const fk_path_t *path, uint32_t segment, int32_t wins_ties, float x_m, float y_m,
                                fk_projection_t *projection)
{
    const float dx_m = path->x_m[segment + 1U] - path->x_m[segment];
    const float dy_m = path->y_m[segment + 1U] - path->y_m[segment];
    const float length2_m2 = dx_m * dx_m + dy_m * dy_m;
    const float offset_x_m = x_m - path->x_m[segment];
    const float offset_y_m = y_m - path->y_m[segment];
    const float fraction = fk_segment_fraction(dx_m, dy_m, length2_m2, offset_x_m, offset_y_m);
    const float across_x_m = offset_x_m - fraction * dx_m;
    const float across_y_m = offset_y_m - fraction * dy_m;
    const float distance2_m2 = across_x_m * across_x_m + across_y_m * across_y_m;

    if ((distance2_m2 < projection->distance2_m2) || ((wins_ties != 0) && (distance2_m2 == projection->distance2_m2))) {
        projection->distance2_m2 = distance2_m2;
        projection->segment = (uint16_t)segment; /* < FK_PATH_POINTS_MAX */
        projection->fraction = fraction;
    }
    return FK_SQRT(length2_m2);
}

void fk_route_project(const fk_path_t *path, float stroke_max_m, float along_points, float x_m, float y_m,
                      fk_projection_t *projection)
{
    const uint32_t last = path->count - 2U; /* count >= 2, checked */
    const float far_m = FK_ROUTE_FAR_STROKES * stroke_max_m;
    const float ahead_limit_m = FK_ROUTE_AHEAD_STROKES * stroke_max_m;
    uint32_t home = (uint32_t)along_points; /* 0 to count - 1, checked */
    uint32_t segment;
    float home_part;
    float length_m;
    float behind_m;
    float ahead_m;

    home = (home > last) ? last : home;
    home_part = along_points - (float)home;
    projection->distance2_m2 = FLT_MAX; /* positions are within 1000 m, so squares stay below 1e7 */
    length_m = fk_project_segment(path, home, 0, x_m, y_m, projection);
    /* Then its neighbours, outwards; the lowest segment wins a tie. */
    behind_m = home_part * length_m;
    for (segment = home; (segment > 0U) && (behind_m < stroke_max_m); segment--) {
        behind_m = behind_m + fk_project_segment(path, segment - 1U, 1, x_m, y_m, projection);
    }
    ahead_m = (1.0f - home_part) * length_m;
    for (segment = home; (segment < last) && (ahead_m < ahead_limit_m); segment++) {
        ahead_m = ahead_m + fk_project_segment(path, segment + 1U, 0, x_m, y_m, projection);
    }
    projection->held = 0U;
    if (projection->distance2_m2 > far_m * far_m) {
        const float dx_m = path->x_m[home + 1U] - path->x_m[home];
        const float dy_m = path->y_m[home + 1U] - path->y_m[home];
        const float across_x_m = (x_m - path->x_m[home]) - home_part * dx_m;
        const float across_y_m = (y_m - path->y_m[home]) - home_part * dy_m;

        projection->distance2_m2 = across_x_m * across_x_m + across_y_m * across_y_m;
        projection->segment = (uint16_t)home;
        projection->fraction = home_part;
        projection->held = 1U;
    }
}

/* Knots that a search needs: those that its levels can reach, and the look-ahead beyond, up to FK_ROUTE_KNOTS_MAX. */
static uint32_t fk_route_knots(uint32_t levels, float look_ahead_steps)
{
    const uint32_t reachable = FK_ROUTE_BEHIND + FK_ROUTE_AHEAD * levels + 2U;
    const uint32_t reached = (reachable < FK_ROUTE_KNOTS_MAX) ? reachable : FK_ROUTE_KNOTS_MAX;
    const uint32_t room = FK_ROUTE_KNOTS_MAX - reached;

    return (look_ahead_steps >= (float)room) ? FK_ROUTE_KNOTS_MAX : reached + (uint32_t)look_ahead_steps;
}

static void fk_route_settings(const fk_plan_config_t *config, float stroke_max_m, fk_route_t *route)
{
    const float soft_m = config->soft_distance_m;

    route->stroke_max_m = stroke_max_m;
    route->step_m = stroke_max_m * FK_ROUTE_PER_STEP;
    route->steps_per_m = 1.0f / route->step_m; /* stroke_max_m >= FK_ROUTE_STROKE_MIN_M */
    route->distance_weight_per_m = config->distance_weight_per_m;
    route->angle_weight_per_rad = config->angle_weight_per_rad;
    route->progress_weight_per_m = config->progress_weight_per_m;
    route->look_ahead_m = config->look_ahead_m;
    route->turn_lead = config->turn_lead;
    route->course_weight_per_m = config->course_weight_per_m;
    route->glide_weight_per_m = config->glide_weight_per_m;
    route->glide_lead = config->glide_lead;
    route->wall_weight_per_m = config->wall_weight_per_m;
    route->wall_glide = config->wall_glide;
    route->wall_min_m[0] = config->wall_x_min_m;
    route->wall_min_m[1] = config->wall_y_min_m;
    route->wall_max_m[0] = config->wall_x_max_m;
    route->wall_max_m[1] = config->wall_y_max_m;
    route->huber2_m2 = soft_m * soft_m;
    route->half_huber_m = 0.5f * soft_m;
    route->half_per_huber = (soft_m > 0.0f) ? 0.5f / soft_m : 0.0f;
}

/* A segment while a route is laid out: its first point, its extent from there, its length. */
typedef struct {
    float x_m;
    float y_m;
    float dx_m;
    float dy_m;
    float length_m;
} fk_segment_t;

static inline void fk_segment_between(fk_segment_t *segment, float x_m, float y_m, float next_x_m, float next_y_m)
{
    segment->x_m = x_m;
    segment->y_m = y_m;
    segment->dx_m = next_x_m - x_m;
    segment->dy_m = next_y_m - y_m;
    segment->length_m = FK_SQRT(segment->dx_m * segment->dx_m + segment->dy_m * segment->dy_m);
}

void fk_route_lay_out(const fk_path_t *path, const fk_plan_config_t *config, float stroke_max_m,
                      const fk_projection_t *projection, fk_route_t *route)
{
    const uint32_t last = path->count - 2U;
    const uint32_t levels = (config->depth < FK_BEAM_DEPTH) ? config->depth : config->depth + FK_BEAM_BEYOND;
    const float step_m = stroke_max_m * FK_ROUTE_PER_STEP;
    uint32_t index = projection->segment;
    fk_knot_t *knot = route->knots;
    const fk_knot_t *end;
    fk_segment_t here;
    int32_t fresh = 1; /* the segment's direction is still to be computed */
    float direction_x = 1.0f;
    float direction_y = 0.0f;
    float next_x_m = path->x_m[index + 1U]; /* the segment's last point */
    float next_y_m = path->y_m[index + 1U];
    float along_m; /* from the segment's first point; below 0 before the path, above its length beyond it */

    fk_route_settings(config, stroke_max_m, route);
    fk_segment_between(&here, path->x_m[index], path->y_m[index], next_x_m, next_y_m);
    along_m = projection->fraction * here.length_m - (float)FK_ROUTE_BEHIND * step_m;
    while ((along_m < 0.0f) && (index > 0U)) {
        index -= 1U;
        next_x_m = here.x_m;
        next_y_m = here.y_m;
        fk_segment_between(&here, path->x_m[index], path->y_m[index], next_x_m, next_y_m);
        along_m = along_m + here.length_m;
    }
    route->last = fk_route_knots(levels, config->look_ahead_m / step_m) - 1U;
    end = &route->knots[route->last];
    for (; knot <= end; knot++) {
        while ((along_m > here.length_m) && (index < last)) {
            const float x_m = next_x_m;
            const float y_m = next_y_m;

            along_m = along_m - here.length_m;
            index += 1U;
            next_x_m = path->x_m[index + 1U];
            next_y_m = path->y_m[index + 1U];
            fk_segment_between(&here, x_m, y_m, next_x_m, next_y_m);
            fresh = 1;
        }
        if ((fresh != 0) && (here.length_m > 0.0f)) { /* else the direction of the segment before stays */
            const float per_m = 1.0f / here.length_m;

            direction_x = here.dx_m * per_m;
            direction_y = here.dy_m * per_m;
        }
        fresh = 0;
        knot->x_m = here.x_m + along_m * direction_x;
        knot->y_m = here.y_m + along_m * direction_y;
        knot->direction_x = direction_x;
        knot->direction_y = direction_y;
        along_m = along_m + step_m;
    }
    route->ahead = (projection->held != 0U) ? 0U : FK_ROUTE_AHEAD;
}

float fk_route_beyond_walls(const fk_route_t *route, float x_m, float y_m)
{
    const float beyond_x_m = fk_larger(0.0f, route->wall_min_m[0] - x_m) + fk_larger(0.0f, x_m - route->wall_max_m[0]);
    const float beyond_y_m = fk_larger(0.0f, route->wall_min_m[1] - y_m) + fk_larger(0.0f, y_m - route->wall_max_m[1]);

    return beyond_x_m + beyond_y_m;
}

int32_t fk_route_may_rest(const fk_tables_t *tables, const fk_route_t *route, const fk_state_t *state)
{
    const float period_s = (float)tables->period_us * 1e-6f;
    const float ahead_s = FK_ROUTE_WALL_PERIODS * period_s;
    const float slow_m = FK_ROUTE_SLOW_STEPS * route->step_m;
    const float speed2 = state->vx_mps * state->vx_mps + state->vy_mps * state->vy_mps;
    float sine;
    float cosine;
    float x_m;
    float y_m;

    /* Speeds may be of any size: an infinite product is not slow. */
    if (speed2 * (period_s * period_s) <= slow_m * slow_m) {
        return 0;
    }
    if (!(route->wall_weight_per_m > 0.0f)) {
        return 1;
    }
    fk_sincos(fk_wrap_angle(state->heading_rad), &sine, &cosine);
    x_m = state->x_m + ahead_s * (cosine * state->vx_mps - sine * state->vy_mps);
    y_m = state->y_m + ahead_s * (sine * state->vx_mps + cosine * state->vy_mps);
    return ((x_m >= route->wall_min_m[0]) && (x_m <= route->wall_max_m[0]) && (y_m >= route->wall_min_m[1])
            && (y_m <= route->wall_max_m[1]))
             ? 1
             : 0;
}

float fk_path_along(const fk_tables_t *tables, const fk_path_t *path, float along_points, float x_m, float y_m,
                    float *distance_m)
{
    fk_projection_t projection;

    fk_route_project(path, fk_route_stroke_max(tables), along_points, x_m, y_m, &projection);
    if (distance_m != NULL) {
        *distance_m = FK_SQRT(projection.distance2_m2);
    }
    return (float)projection.segment + projection.fraction;
}
