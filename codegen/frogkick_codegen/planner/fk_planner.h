/* fk_planner.h - picks the next action of a stroke-driven robot from a table of transitions.
 *
 * Method: receding-horizon control. At each decision a search over sequences of actions finds one of least cost on the
 * table's model, and only its first action is taken. It is a depth-limited branch and bound; with the route cost the
 * larger depths are a beam search.
 *
 * C99, no libc, no heap, no recursion, no double. The caller owns all state. The same bits come out of the
 * Python twin, a PC and the chip, provided that the compiler rounds every operation to float32 once: build
 * with -ffp-contract=off -fno-math-errno, never with -ffast-math. fk_tables_open() tests this when it runs.
 *
 * Frames: world x, y on the pool plane, heading from +x counter-clockwise. Body x forward, y left.
 * Units: SI, in every name. Angles wrap to (-FK_PI, FK_PI].
 * Every function that can fail returns FK_OK or a negative fk_error_t and then leaves its outputs untouched.
 */
#ifndef FK_PLANNER_H
#define FK_PLANNER_H

#include "fk_tables.h"

#ifdef __cplusplus
extern "C" {
#endif

#define FK_PATH_POINTS_MAX 100U    /* points of a path: 2 to 100 */
#define FK_DEPTH_MAX 4U            /* depth of the search: 1 to 4 */
#define FK_POSITION_MAX_M 1000.0f  /* |x|, |y| of a state or a path point */
#define FK_HEADING_MAX_RAD 1000.0f /* |heading| of a state, |tangent| of a path point */
#define FK_ANGLE_MAX_RAD 2100.0f   /* |angle| that fk_wrap_angle and fk_sincos accept */
#define FK_PI 3.14159274f          /* pi rounded to float32 (a little above pi) */

/* The robot's state. All floats finite; pose in the world frame, velocity in the BODY frame. */
typedef struct {
    float x_m;         /* |x| <= FK_POSITION_MAX_M */
    float y_m;         /* |y| <= FK_POSITION_MAX_M */
    float heading_rad; /* |heading| <= FK_HEADING_MAX_RAD, any number of turns; outputs are wrapped */
    float vx_mps;      /* forward; any finite value; beyond the table's states it counts as at their edge */
    float vy_mps;      /* left; clamped likewise */
    float omega_rad_s; /* counter-clockwise; clamped likewise */
    uint16_t limb_use[FK_LIMBS_MAX]; /* recent use of each limb, 0 (rested) to FK_LIMB_USE_MAX */
    float along_points; /* position along the path at the last decision, in points: 0 (at the start) to count - 1.
                         * FK_COST_ROUTE projects the state near there; fk_plan_t has the value for the next one */
} fk_state_t;

/* The path to follow, world frame. Points in the order of progress; equal points are allowed. */
typedef struct {
    uint16_t count;                        /* 2 to FK_PATH_POINTS_MAX */
    float x_m[FK_PATH_POINTS_MAX];         /* |x| <= FK_POSITION_MAX_M; only the first count are read */
    float y_m[FK_PATH_POINTS_MAX];         /* |y| <= FK_POSITION_MAX_M */
    float tangent_rad[FK_PATH_POINTS_MAX]; /* direction of travel, |tangent| <= FK_HEADING_MAX_RAD */
} fk_path_t;

/* costs: made by python -m frogkick_codegen.frames */
/* The cost of a motion. The numbers are part of the link's protocol. */
typedef enum {
    FK_COST_PAPER = 0, /* the paper's Eq. 19, as its authors ran it */
    FK_COST_ROUTE = 1, /* distance and progress as stage cost, course as terminal cost: route.c */
    FK_COST_LAST = 1 /* the highest number */
} fk_cost_t;

/* Weights, lengths, places of the costs: WEIGHT(name, NAME, least 0 or -largest, largest). */
#define FK_PLAN_WEIGHTS(WEIGHT) \
    WEIGHT(distance_weight_per_m, DISTANCE_WEIGHT_PER_M, 0.0f, 1000000.0f) \
    WEIGHT(angle_weight_per_rad, ANGLE_WEIGHT_PER_RAD, 0.0f, 1000000.0f) \
    WEIGHT(progress_weight, PROGRESS_WEIGHT, 0.0f, 1000000.0f) \
    WEIGHT(level_weight, LEVEL_WEIGHT, 0.0f, 1000000.0f) \
    WEIGHT(progress_weight_per_m, PROGRESS_WEIGHT_PER_M, 0.0f, 1000000.0f) \
    WEIGHT(look_ahead_m, LOOK_AHEAD_M, 0.0f, 1000000.0f) \
    WEIGHT(soft_distance_m, SOFT_DISTANCE_M, 0.0f, 1000000.0f) \
    WEIGHT(turn_lead, TURN_LEAD, 0.0f, 2.0f) \
    WEIGHT(course_weight_per_m, COURSE_WEIGHT_PER_M, 0.0f, 1000000.0f) \
    WEIGHT(glide_weight_per_m, GLIDE_WEIGHT_PER_M, 0.0f, 1000000.0f) \
    WEIGHT(glide_lead, GLIDE_LEAD, 0.0f, 2.0f) \
    WEIGHT(wall_weight_per_m, WALL_WEIGHT_PER_M, 0.0f, 1000000.0f) \
    WEIGHT(wall_glide, WALL_GLIDE, 0.0f, 100.0f) \
    WEIGHT(wall_x_min_m, WALL_X_MIN_M, -1000.0f, 1000.0f) \
    WEIGHT(wall_x_max_m, WALL_X_MAX_M, -1000.0f, 1000.0f) \
    WEIGHT(wall_y_min_m, WALL_Y_MIN_M, -1000.0f, 1000.0f) \
    WEIGHT(wall_y_max_m, WALL_Y_MAX_M, -1000.0f, 1000.0f)

/* What to plan for. Weights of the other cost are only checked. */
typedef struct {
    float distance_weight_per_m; /* x distance to the nearest path point (paper: 500), or to the path (route) */
    float angle_weight_per_rad;  /* x angle between heading and path: its tangent there (paper: 50); route: between
                                  * course and target point look_ahead_m further on, at a branch's end only */
    float progress_weight;       /* paper: x (1 - index / (count - 1)); paper: 300 */
    float level_weight;          /* paper: a level's cost x (1 + level_weight * levels below it); paper: 0.3 */
    float progress_weight_per_m; /* route: x how much less a motion advances than the table's longest stroke */
    float look_ahead_m;          /* route: how far along the path the course's target point lies */
    float soft_distance_m;       /* route: threshold of the Huber loss, below which distance counts by its square */
    float turn_lead;             /* route: x the last turn, by which the robot turns further */
    float course_weight_per_m;   /* route: x the last motion; with the heading it is the course of a branch's end */
    float glide_weight_per_m;    /* route: x distance from the path of the point to which a branch's end glides */
    float glide_lead;            /* route: x the last motion, turned further, by which a branch's end glides */
    float wall_weight_per_m;     /* route: x how far each motion's end, and the point to which the last glides, lie
                                  * beyond the walls */
    float wall_glide;            /* route: x the last motion, by which the robot glides towards a wall */
    float wall_x_min_m;          /* route: where its centre may be, world */
    float wall_x_max_m;          /* likewise */
    float wall_y_min_m;          /* likewise */
    float wall_y_max_m;          /* likewise */
/* costs end */
    uint32_t transitions_max;    /* transitions after which the search ends, 0 = no limit; the first level is
                                  * always finished */
    uint8_t cost;                /* fk_cost_t */
    uint8_t depth;               /* levels to look ahead, 1 to FK_DEPTH_MAX; paper: 1 on the robot; route: from 3 on a
                                  * beam search of four levels more */
} fk_plan_config_t;

/* A decision. */
typedef struct {
    uint8_t action;         /* index into the table's actions: first action of the branch of least cost */
    uint8_t depth_reached;  /* levels that were finished: fewer than planned where transitions_max ended the search */
    uint16_t nearest_state; /* row of the table nearest to the state's velocity */
    uint16_t path_index;    /* path point nearest to the state (paper), or last one that it has passed (route) */
    uint32_t transitions;   /* transitions evaluated, of all levels */
    float cost;             /* sum over the branch, >= 0 */
    float distance_m;       /* of the state from that point (paper), or from the path (route) */
    float along_points;     /* position of the state along the path, in points: copy it to the next state */
    fk_state_t predicted;   /* after the FIRST action: heading wrapped, velocity as the table holds it */
} fk_plan_t;

/* Choose the next action (the paper's Algorithm 1 with a fixed per-axis metric).
 * Least cost wins, ties take the lowest first action.
 * Branch and bound: branches that cannot win are pruned, so the answer is that of the full tree. Level 1 is searched
 * first, then the full depth, or level after level where transitions_max may cut that; a level that is cut still counts
 * if the best first action of the level before it was finished.
 * Beam search (route, depth 3 and 4): of each level the 12 branches that would cost least if they ended there are
 * carried on, four levels beyond the depth. A level that transitions_max may cut is not begun.
 * Stack: below 3700 bytes.
 * @retval FK_OK
 * @retval FK_ERROR_NULL, FK_ERROR_DEPTH, FK_ERROR_COST, FK_ERROR_WEIGHT, FK_ERROR_PATH_COUNT,
 *         FK_ERROR_PATH_POINT, FK_ERROR_NOT_FINITE, FK_ERROR_RANGE in this order of checks */
int32_t fk_plan(const fk_tables_t *tables, const fk_path_t *path, const fk_plan_config_t *config,
                const fk_state_t *state, fk_plan_t *plan);

/* Check a path as fk_plan() does.
 * @retval FK_OK
 * @retval FK_ERROR_NULL, FK_ERROR_PATH_COUNT, FK_ERROR_PATH_POINT */
int32_t fk_path_check(const fk_path_t *path);

/* Point nearest to (x_m, y_m), the lowest index on ties. path: checked; x_m, y_m: finite.
 * *distance2_m2 (may be null): squared distance, m^2. Returns the index, below path->count. */
uint16_t fk_path_nearest(const fk_path_t *path, float x_m, float y_m, float *distance2_m2);

/* Project a position onto the path near along_points, the projection before: fk_plan_t.along_points for a position
 * between decisions. Returns the position along the path, in points, 0 to count - 1. path, position: as for
 * fk_plan(); along_points: 0 to path->count - 1. *distance_m (may be null): distance of the position from its
 * projection. */
float fk_path_along(const fk_tables_t *tables, const fk_path_t *path, float along_points, float x_m, float y_m,
                    float *distance_m);

/* Wrap to (-FK_PI, FK_PI]. Error <= 4e-7 rad for |angle| <= FK_ANGLE_MAX_RAD; exact for angles already
 * within. Beyond that, and for NaN or infinity, the result is NaN (bits 0x7FC00000). */
float fk_wrap_angle(float angle_rad);

/* Sine and cosine. Error <= 1.6 * 2^-24 (measured by tests/codegen) for |angle| <= FK_ANGLE_MAX_RAD.
 * Beyond FK_ANGLE_MAX_RAD, and for NaN or infinity: both NaN. */
void fk_sincos(float angle_rad, float *sine, float *cosine);

/* Turn a world-frame velocity into the body frame of a robot with this heading
 * (|heading| <= FK_ANGLE_MAX_RAD; beyond that both are NaN). */
void fk_velocity_to_body(float heading_rad, float vx_world_mps, float vy_world_mps, float *vx_body_mps,
                         float *vy_body_mps);

/* 1 if NaN or infinite, else 0. Works on bits, so that no compiler option can remove it. */
int32_t fk_float_is_not_finite(float value);

#ifdef __cplusplus
}
#endif

#endif
