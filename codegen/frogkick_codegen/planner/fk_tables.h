/* fk_tables.h - a table of transitions: opening and checking its image, and looking up what it predicts.
 *
 * C99, no libc, no heap, no recursion, no double. Frames: body x forward, y left. Units: SI, in every name.
 * Every function that can fail returns FK_OK or a negative fk_error_t and then leaves its outputs untouched.
 */
#ifndef FK_TABLES_H
#define FK_TABLES_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define FK_FORMAT_VERSION 3U       /* newest table image format that this code reads: with wear curves */
#define FK_FORMAT_PLAIN 2U         /* the same without wear curves */
#define FK_KIND_NEAREST 1U         /* kind of table: nearest library state, the paper's table */
#define FK_KIND_AFFINE 2U          /* nearest state, local linear correction, history of the limbs */
#define FK_IMAGE_HEADER_BYTES 176U /* bytes before the first section */
#define FK_ROBOT_ID_BYTES 16U      /* at most 15 printable ASCII characters, then NUL to the end */
#define FK_PROVENANCE_BYTES 32U    /* SHA-256 of the library that the table was made from */
#define FK_ACTIONS_MAX 32U         /* actions of a table: 1 to 32 */
#define FK_LIMBS_MAX 8U            /* limbs of a robot: 1 to 8, bit i of a mask is limb i */
#define FK_LIMB_USE_MAX 32767U     /* recent use of a limb: 0 = rested, this = the most */
#define FK_VELOCITY_CODE_MAX 16383 /* |velocity code|; see nearest.c for why */
#define FK_MOTION_CODE_MAX 32767   /* |motion code| */
#define FK_TREE_LEVELS_MAX 13U     /* levels of the search tree: leaves of 8 rows at least in the largest table */
#define FK_BLOCK_LEVELS_MAX 8U     /* a table of kind nearest has 1 to 256 blocks with a prediction of their own */
#define FK_WEAR_KNOTS_MAX 16U      /* of a limb's wear curve, 0: the image has none */
#define FK_LOST_MAX 32767U         /* share of its contribution that a limb has lost: 0 = none, this = all */
#define FK_COEFFICIENTS 10U        /* of a quadratic prediction: 1, three codes, their six products */
#define FK_SCALE_MIN 1e-9f         /* least value of one code, m, rad, m/s or rad/s */
#define FK_SCALE_MAX 0.03f         /* largest value of one code: a motion stays below 1000 m, 1000 rad */

/* Numbers are part of the protocol and of the logs: never renumber. */
typedef enum {
    FK_OK = 0,
    FK_ERROR_NULL = -1,            /* a pointer is null */
    FK_ERROR_NOT_FINITE = -2,      /* a state holds NaN or infinity */
    FK_ERROR_RANGE = -3,           /* a state beyond FK_POSITION_MAX_M or FK_HEADING_MAX_RAD */
    FK_ERROR_DEPTH = -4,           /* depth is not 1 to FK_DEPTH_MAX */
    FK_ERROR_WEIGHT = -5,          /* a weight is NaN or not 0 to its largest value */
    FK_ERROR_PATH_COUNT = -6,      /* a path has fewer than 2 or more than FK_PATH_POINTS_MAX points */
    FK_ERROR_PATH_POINT = -7,      /* a point or tangent is not finite or beyond the limits of a state */
    FK_ERROR_ACTION = -8,          /* an action index is not below the table's number of actions */
    FK_ERROR_ROBOT = -9,           /* the table is for another robot */
    FK_ERROR_COST = -11,           /* a configuration's cost is no fk_cost_t */
    FK_ERROR_FLOAT_RULES = -10,    /* this build fuses a*b+c, keeps excess precision or flushes subnormals */
    FK_ERROR_IMAGE_SIZE = -20,     /* fewer bytes than a header */
    FK_ERROR_IMAGE_MAGIC = -21,    /* not a table image */
    FK_ERROR_IMAGE_VERSION = -22,  /* another format version: version 1 must be made again */
    FK_ERROR_IMAGE_KIND = -23,     /* a kind of table that this planner does not know */
    FK_ERROR_IMAGE_LENGTH = -24,   /* the image's own length is not the given size: truncated or joined */
    FK_ERROR_IMAGE_CRC = -25,      /* damaged */
    FK_ERROR_IMAGE_COUNT = -26,    /* states, actions, limbs or levels out of range */
    FK_ERROR_IMAGE_OFFSET = -27,   /* a section is not where the counts put it */
    FK_ERROR_IMAGE_ROBOT_ID = -28, /* not 1 to 15 printable characters with NUL to the end */
    FK_ERROR_IMAGE_TIMES = -29,    /* pulse 0, or pulse or second delay not shorter than the period */
    FK_ERROR_IMAGE_SCALE = -30,    /* a scale is NaN or not FK_SCALE_MIN to FK_SCALE_MAX; a limit, shift, unit,
                                      decay or gain is out of range */
    FK_ERROR_IMAGE_ACTION = -31,   /* an action's name is unprintable or repeated, or fires a missing limb */
    FK_ERROR_IMAGE_PADDING = -32,  /* a reserved or padding byte is not zero */
    FK_ERROR_IMAGE_CODE = -33,     /* a code, coefficient or derivative is out of range */
    FK_ERROR_IMAGE_ORDER = -34,    /* the states are not in k-d order */
    FK_ERROR_IMAGE_COLUMN = -35    /* the columns' bits do not fill a state's transitions */
} fk_error_t;

/* One action: two groups of limbs, the second one second_delay_us after the first. */
typedef struct {
    char name;           /* printable ASCII, unique within a table */
    uint8_t first_mask;  /* bit i = limb i; 0 = no limb */
    uint8_t second_mask; /* likewise */
} fk_action_t;

/* An opened table: pointers into the image, which must outlive it. Filled by fk_tables_open() only. */
typedef struct {
    const uint8_t *action_rows;          /* actions x 4 bytes */
    const uint8_t *wear_curves;          /* limbs x wear_knots x 6 i16 */
    const int16_t *worn;                 /* actions x 6 codes added to every look-up for worn limbs; null: none.
                                            Set by whoever estimates the wear, after fk_tables_open() */
    const uint8_t *columns;              /* actions x 6 descriptions of where residuals are; lookup.c, by kind */
    const uint8_t *splits;               /* 2^tree_levels - 1 int16, little-endian, heap order */
    const uint8_t *models;               /* nearest: blocks x actions x 6 x FK_COEFFICIENTS int16 */
    const uint8_t *state_rows;           /* states x 3 int16, little-endian, in k-d order */
    const uint8_t *transition_rows;      /* states x row_bytes of residuals */
    const uint8_t *provenance;           /* FK_PROVENANCE_BYTES */
    uint32_t image_bytes;                /* length of the whole image */
    uint32_t image_crc32;                /* as in the header, verified: names the image in logs */
    uint32_t period_us;                  /* one action's time */
    uint32_t pulse_us;                   /* > 0, < period_us */
    uint32_t second_delay_us;            /* < period_us */
    float velocity_scale[3];             /* per code: m/s forward, m/s left, rad/s */
    float codes_per_velocity[3];         /* 1 / velocity_scale in float32 */
    float motion_scale[3];               /* per code: m forward, m left, rad */
    float stroke_max_m;                  /* no look-up moves the robot further in one period */
    float turn_max_rad;                  /* no look-up turns it further, either way */
    int32_t state_least[3];              /* least code of the states on each axis */
    int32_t state_most[3];               /* largest code of the states on each axis */
    int32_t motion_limit[3];             /* largest |motion code| of a look-up, 1 to FK_MOTION_CODE_MAX */
    int32_t offset_limit[3];             /* affine: largest |query - state| that is corrected for, codes */
    uint32_t axes;                       /* two bits for each level of the search tree, the root's the lowest */
    uint16_t unit[6];                    /* codes per unit of a residual */
    uint16_t states;                     /* 1 to 65535 */
    uint16_t row_bytes;                  /* of one state's transitions */
    uint16_t use_decay;                  /* share of a limb's use that is left a period later, in 1/32768 */
    uint16_t use_gain;                   /* what firing adds to it, in 1/32768 */
    uint8_t shift[6];                    /* of a prediction (nearest) or a correction (affine) */
    uint8_t up[3];                       /* nearest: left shift of the state codes before prediction */
    uint8_t kind;                        /* FK_KIND_NEAREST, FK_KIND_AFFINE */
    uint8_t tree_levels;                 /* 0 to FK_TREE_LEVELS_MAX */
    uint8_t block_levels;                /* 0 to FK_BLOCK_LEVELS_MAX */
    uint8_t actions;                     /* 1 to FK_ACTIONS_MAX */
    uint8_t limbs;                       /* 1 to FK_LIMBS_MAX */
    uint8_t wear_knots;                  /* 0 (no curves) to FK_WEAR_KNOTS_MAX */
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

/* CRC-32 as zlib's: start with crc = 0, feed further bytes with the result so far.
 * bytes may be null if length is 0. */
uint32_t fk_crc32(uint32_t crc, const uint8_t *bytes, uint32_t length);

/* The part of a state that determines its next motion. */
typedef struct {
    int32_t velocity_code[3];        /* body frame, |code| <= FK_VELOCITY_CODE_MAX */
    uint16_t limb_use[FK_LIMBS_MAX]; /* recent use of each limb; 0 = rested. Not an input of kind nearest */
} fk_dynamics_t;

/* The row of a table that a state is looked up in. */
typedef struct {
    const uint8_t *residuals; /* the row's */
    const uint8_t *model;     /* nearest: coefficients of the row's block; affine: null */
    uint32_t factors[FK_COEFFICIENTS / 2U]; /* nearest: pairs of int16, the first in the lower half: 16384, the
                                               row's codes shifted left, their products, within +-16384.
                                               affine: the limbs' uses likewise */
    int32_t offset[3];                      /* affine: query - row, clamped, codes */
    uint16_t row;
} fk_lookup_t;

/* A motion over one period, body frame at its start. */
typedef struct {
    float forward_m;
    float left_m;
    float turn_rad;
} fk_motion_t;

/* Velocity as a code, rounded half away from zero and clamped to +-FK_VELOCITY_CODE_MAX. velocity: finite. */
int32_t fk_velocity_code(float velocity, float codes_per_velocity);

/* Find the row nearest to a state, the lowest on ties. The functions below then evaluate it for each action. */
void fk_lookup(const fk_tables_t *tables, const fk_dynamics_t *from, fk_lookup_t *lookup);

/* Motion of an action (index below tables->actions) from the state that was looked up. */
void fk_lookup_motion(const fk_tables_t *tables, const fk_lookup_t *lookup, const fk_dynamics_t *from,
                      uint32_t action, fk_motion_t *motion);

/* Dynamics at that action's end. next and from may not be the same. */
void fk_lookup_next(const fk_tables_t *tables, const fk_lookup_t *lookup, const fk_dynamics_t *from,
                    uint32_t action, fk_dynamics_t *next);

/* Recent use of each limb after one action (index below tables->actions): it decays, and grows where the action
 * fires the limb, to FK_LIMB_USE_MAX at most; 0 for limbs that the robot lacks and for kind nearest. use, next:
 * FK_LIMBS_MAX values, which may be the same. */
void fk_limb_use_after(const fk_tables_t *tables, const uint16_t *use, uint32_t action, uint16_t *next);

/* How a limb that has lost a share (0 to FK_LOST_MAX) of its contribution changes the six values of each action
 * that fires it, in codes. wear_knots: not 0. */
void fk_wear_curve(const fk_tables_t *tables, uint32_t limb, uint32_t lost, int32_t codes[6]);

/* How the limbs together change every action, 6 x tables->actions codes, where each has lost this share.
 * wear_knots: not 0. */
void fk_wear_shift(const fk_tables_t *tables, const uint16_t lost[FK_LIMBS_MAX], int16_t *shift);

#ifdef __cplusplus
}
#endif

#endif
