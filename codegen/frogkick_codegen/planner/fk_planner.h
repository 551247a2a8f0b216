/* fk_planner.h - picks the next action of a stroke-driven robot from a table of transitions.
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

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define FK_FORMAT_VERSION 1U       /* table image format that this code reads */
#define FK_KIND_NEAREST 1U         /* kind of table: nearest library state, the paper's table */
#define FK_IMAGE_HEADER_BYTES 128U /* bytes before the first section */
#define FK_ROBOT_ID_BYTES 16U      /* at most 15 printable ASCII characters, then NUL to the end */
#define FK_PROVENANCE_BYTES 32U    /* SHA-256 of the library that the table was made from */
#define FK_ACTIONS_MAX 32U         /* actions of a table: 1 to 32 */
#define FK_LIMBS_MAX 8U            /* limbs of a robot: 1 to 8, bit i of a mask is limb i */
#define FK_VELOCITY_CODE_MAX 16383 /* |velocity code|; see nearest.c for why */
#define FK_MOTION_CODE_MAX 32767   /* |motion code|; -32768 is refused */
#define FK_SCALE_MIN 1e-9f         /* least value of one code, m, rad, m/s or rad/s */
#define FK_SCALE_MAX 0.03f         /* largest value of one code: a motion stays below 1000 m, 1000 rad */
#define FK_PATH_POINTS_MAX 100U    /* points of a path: 2 to 100 */
#define FK_DEPTH_MAX 4U            /* levels that the planner looks ahead: 1 to 4 */
#define FK_POSITION_MAX_M 1000.0f  /* |x|, |y| of a state or a path point */
#define FK_HEADING_MAX_RAD 1000.0f /* |heading| of a state, |tangent| of a path point */
#define FK_ANGLE_MAX_RAD 2100.0f   /* |angle| that fk_wrap_angle and fk_sincos accept */
#define FK_WEIGHT_MAX 1e6f         /* weights of the cost: 0 to 1e6 */
#define FK_PI 3.14159274f          /* pi rounded to float32 (a little above pi) */

/* Numbers are part of the protocol and of the logs: never renumber. */
typedef enum {
    FK_OK = 0,
    FK_ERROR_NULL = -1,            /* a pointer is null */
    FK_ERROR_NOT_FINITE = -2,      /* a state holds NaN or infinity */
    FK_ERROR_RANGE = -3,           /* a state beyond FK_POSITION_MAX_M or FK_HEADING_MAX_RAD */
    FK_ERROR_DEPTH = -4,           /* depth is not 1 to FK_DEPTH_MAX */
    FK_ERROR_WEIGHT = -5,          /* a weight is NaN or not 0 to FK_WEIGHT_MAX */
    FK_ERROR_PATH_COUNT = -6,      /* a path has fewer than 2 or more than FK_PATH_POINTS_MAX points */
    FK_ERROR_PATH_POINT = -7,      /* a point or tangent is not finite or beyond the limits of a state */
    FK_ERROR_ACTION = -8,          /* an action index is not below the table's number of actions */
    FK_ERROR_ROBOT = -9,           /* the table is for another robot */
    FK_ERROR_FLOAT_RULES = -10,    /* this build fuses a*b+c, keeps excess precision or flushes subnormals */
    FK_ERROR_IMAGE_SIZE = -20,     /* fewer bytes than a header */
    FK_ERROR_IMAGE_MAGIC = -21,    /* not a table image */
    FK_ERROR_IMAGE_VERSION = -22,  /* a newer (or no) format version */
    FK_ERROR_IMAGE_KIND = -23,     /* a kind of table that this planner does not know */
    FK_ERROR_IMAGE_LENGTH = -24,   /* the image's own length is not the given size: truncated or joined */
    FK_ERROR_IMAGE_CRC = -25,      /* damaged */
    FK_ERROR_IMAGE_COUNT = -26,    /* states, actions or limbs out of range */
    FK_ERROR_IMAGE_OFFSET = -27,   /* a section is not where the counts put it */
    FK_ERROR_IMAGE_ROBOT_ID = -28, /* not 1 to 15 printable characters with NUL to the end */
    FK_ERROR_IMAGE_TIMES = -29,    /* pulse 0, or pulse or second delay not shorter than the period */
    FK_ERROR_IMAGE_SCALE = -30,    /* a scale is NaN or not FK_SCALE_MIN to FK_SCALE_MAX */
    FK_ERROR_IMAGE_ACTION = -31,   /* an action's name is unprintable or repeated, or fires a missing limb */
    FK_ERROR_IMAGE_PADDING = -32,  /* a reserved or padding byte is not zero */
    FK_ERROR_IMAGE_CODE = -33,     /* a code is out of range */
    FK_ERROR_IMAGE_ORDER = -34     /* the states are not in k-d order */
} fk_error_t;

/* The robot's state. All six finite; pose in the world frame, velocity in the BODY frame. */
typedef struct {
    float x_m;         /* |x| <= FK_POSITION_MAX_M */
    float y_m;         /* |y| <= FK_POSITION_MAX_M */
    float heading_rad; /* |heading| <= FK_HEADING_MAX_RAD, any number of turns; outputs are wrapped */
    float vx_mps;      /* forward; any finite value, clamped to +-16383 codes for the table look-up */
    float vy_mps;      /* left; clamped likewise */
    float omega_rad_s; /* counter-clockwise; clamped likewise */
} fk_state_t;

/* The path to follow, world frame. Points in the order of progress; equal points are allowed. */
typedef struct {
    uint16_t count;                        /* 2 to FK_PATH_POINTS_MAX */
    float x_m[FK_PATH_POINTS_MAX];         /* |x| <= FK_POSITION_MAX_M; only the first count are read */
    float y_m[FK_PATH_POINTS_MAX];         /* |y| <= FK_POSITION_MAX_M */
    float tangent_rad[FK_PATH_POINTS_MAX]; /* direction of travel, |tangent| <= FK_HEADING_MAX_RAD */
} fk_path_t;

/* Weights of the cost of one predicted state (the paper's Eq. 19 as its authors ran it). */
typedef struct {
    float distance_weight_per_m; /* x distance to the nearest path point; 0 to FK_WEIGHT_MAX; paper: 500 */
    float angle_weight_per_rad;  /* x |heading - tangent there|, wrapped; 0 to FK_WEIGHT_MAX; paper: 50 */
    float progress_weight;       /* x (1 - index / (count - 1)); 0 to FK_WEIGHT_MAX; paper: 300 */
    float level_weight;          /* a level's cost x (1 + level_weight * levels below it); paper: 0.3 */
    uint8_t depth;               /* levels to look ahead, 1 to FK_DEPTH_MAX; paper: 1 on the robot */
} fk_plan_config_t;

/* A decision. */
typedef struct {
    uint8_t action;         /* index into the table's actions: first action of the branch of least cost */
    uint16_t nearest_state; /* row of the table nearest to the state's velocity */
    uint16_t path_index;    /* path point nearest to the state's position */
    float cost;             /* sum over the branch, >= 0 */
    fk_state_t predicted;   /* after the FIRST action: heading wrapped, velocity as the table holds it */
} fk_plan_t;

/* One action: two groups of limbs, the second one second_delay_us after the first. */
typedef struct {
    char name;           /* printable ASCII, unique within a table */
    uint8_t first_mask;  /* bit i = limb i; 0 = no limb */
    uint8_t second_mask; /* likewise */
} fk_action_t;

/* An opened table: pointers into the image, which must outlive it. Filled by fk_tables_open() only. */
typedef struct {
    const uint8_t *action_rows;          /* actions x 4 bytes */
    const uint8_t *state_rows;           /* states x 3 int16, little-endian, in k-d order */
    const uint8_t *transition_rows;      /* states x actions x 6 int16, little-endian */
    const uint8_t *provenance;           /* FK_PROVENANCE_BYTES */
    uint32_t image_bytes;                /* length of the whole image */
    uint32_t image_crc32;                /* as in the header, verified: names the image in logs */
    uint32_t period_us;                  /* one action's time */
    uint32_t pulse_us;                   /* > 0, < period_us */
    uint32_t second_delay_us;            /* < period_us */
    float velocity_scale[3];             /* per code: m/s forward, m/s left, rad/s */
    float codes_per_velocity[3];         /* 1 / velocity_scale in float32 */
    float motion_scale[3];               /* per code: m forward, m left, rad */
    uint16_t states;                     /* 1 to 65535 */
    uint8_t actions;                     /* 1 to FK_ACTIONS_MAX */
    uint8_t limbs;                       /* 1 to FK_LIMBS_MAX */
    char robot_id[FK_ROBOT_ID_BYTES];    /* NUL-terminated */
} fk_tables_t;

/* Check every byte of an image and open it. O(size): once at start-up, not for each decision.
 * image: any alignment (4-byte alignment is faster on the chip); size: exactly the image's length.
 * @retval FK_OK opened
 * @retval FK_ERROR_NULL, FK_ERROR_FLOAT_RULES, FK_ERROR_IMAGE_... the first thing that is wrong */
int32_t fk_tables_open(const uint8_t *image, uint32_t size, fk_tables_t *tables);

/* Refuse a table made for another robot.
 * robot_id: NUL-terminated; compared up to FK_ROBOT_ID_BYTES characters.
 * @retval FK_OK the same robot
 * @retval FK_ERROR_NULL, FK_ERROR_ROBOT */
int32_t fk_tables_check_robot(const fk_tables_t *tables, const char *robot_id);

/* Read one action.
 * @retval FK_OK
 * @retval FK_ERROR_NULL, FK_ERROR_ACTION index >= tables->actions */
int32_t fk_tables_action(const fk_tables_t *tables, uint8_t index, fk_action_t *action);

/* Choose the next action (the paper's Algorithm 1 with a fixed per-axis metric).
 * Least cost wins, ties take the lowest action of the first level that differs. Stack: below 700 bytes.
 * @retval FK_OK
 * @retval FK_ERROR_NULL, FK_ERROR_DEPTH, FK_ERROR_WEIGHT, FK_ERROR_PATH_COUNT, FK_ERROR_PATH_POINT,
 *         FK_ERROR_NOT_FINITE, FK_ERROR_RANGE in this order of checks */
int32_t fk_plan(const fk_tables_t *tables, const fk_path_t *path, const fk_plan_config_t *config,
                const fk_state_t *state, fk_plan_t *plan);

/* Check a path as fk_plan() does, for whoever receives one.
 * @retval FK_OK
 * @retval FK_ERROR_NULL, FK_ERROR_PATH_COUNT, FK_ERROR_PATH_POINT */
int32_t fk_path_check(const fk_path_t *path);

/* Point nearest to (x_m, y_m), the lowest index on ties. path: checked; x_m, y_m: finite.
 * *distance2_m2 (may be null): squared distance, m^2. Returns the index, below path->count. */
uint16_t fk_path_nearest(const fk_path_t *path, float x_m, float y_m, float *distance2_m2);

/* CRC-32 as zlib's: start with crc = 0, feed further bytes with the result so far.
 * bytes may be null if length is 0. */
uint32_t fk_crc32(uint32_t crc, const uint8_t *bytes, uint32_t length);

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
