/* Made from host/frogkick/link/frames.toml by: python -m frogkick_codegen.frames. Do not edit.
 * Protocol version 7. Payloads of the link: commands are unpacked, answers and events packed.
 */
#ifndef FK_FRAMES_LAYOUT_H
#define FK_FRAMES_LAYOUT_H

#include <stdint.h>

#define FK_PROTOCOL_VERSION 7u
#define FK_PAYLOAD_BYTES_MAX 231u
#define FK_ANSWER_BIT 0x80u
#define FK_EVENT_BIT 0x40u
#define FK_AUTH_BIT 0x20u

enum { /* status of an answer */
    FK_STATUS_OK = 0,
    FK_STATUS_NOT_FINITE = -2,
    FK_STATUS_RANGE = -3,
    FK_STATUS_DEPTH = -4,
    FK_STATUS_WEIGHT = -5,
    FK_STATUS_PATH_COUNT = -6,
    FK_STATUS_PATH_POINT = -7,
    FK_STATUS_STATE = -64,
    FK_STATUS_LENGTH = -65,
    FK_STATUS_UNKNOWN = -66,
    FK_STATUS_NO_PATH = -67,
    FK_STATUS_STALE = -68,
    FK_STATUS_VALUE = -69,
    FK_STATUS_DOUBLE = -70,
    FK_STATUS_OLD = -71,
    FK_STATUS_OUTLIER = -72,
    FK_STATUS_PASSED = -73,
    FK_STATUS_STALLED = -74,
    FK_STATUS_VERSION = -75,
    FK_STATUS_SUPPLY = -77,
    FK_STATUS_AUTH = -78,
    FK_STATUS_MAC = -79,
    FK_STATUS_FAULT = -76,
    FK_STATUS_FLASH = -96,
    FK_STATUS_SLOT = -97,
    FK_STATUS_OFFSET = -98,
    FK_STATUS_HASH = -99,
    FK_STATUS_TABLE = -100,
    FK_STATUS_WORN = -101
};

enum { /* state of the robot */
    FK_STATE_DISARMED = 0,
    FK_STATE_ARMED = 1,
    FK_STATE_RUNNING = 2,
    FK_STATE_FAULT = 3
};

enum { /* internal errors */
    FK_FAULT_NONE = 0,
    FK_FAULT_TABLE = 1,
    FK_FAULT_TIME = 2,
    FK_FAULT_STATE = 3,
    FK_FAULT_GUARD = 4,
    FK_FAULT_ACTION = 5,
    FK_FAULT_PULSE = 6,
    FK_FAULT_CLOCK = 7,
    FK_FAULT_STORE = 8
};

enum { /* why the robot started */
    FK_RESET_UNKNOWN = 0,
    FK_RESET_POWER = 1,
    FK_RESET_PIN = 2,
    FK_RESET_SOFTWARE = 3,
    FK_RESET_WATCHDOG = 4,
    FK_RESET_LOCKUP = 5
};

enum { /* the limbs' supply */
    FK_SUPPLY_OK = 0,
    FK_SUPPLY_FELL = 1,
    FK_SUPPLY_LOW = 2
};

enum { /* who may command the robot */
    FK_OWNER_OPEN = 0,
    FK_OWNER_KEY = 1
};

enum { /* PARAM */
    FK_PARAMETER_DEPTH = 1,
    FK_PARAMETER_DISTANCE_WEIGHT_PER_M = 2,
    FK_PARAMETER_ANGLE_WEIGHT_PER_RAD = 3,
    FK_PARAMETER_PROGRESS_WEIGHT = 4,
    FK_PARAMETER_LEVEL_WEIGHT = 5,
    FK_PARAMETER_PERIOD_US = 6,
    FK_PARAMETER_COST = 7,
    FK_PARAMETER_PROGRESS_WEIGHT_PER_M = 8,
    FK_PARAMETER_LOOK_AHEAD_M = 9,
    FK_PARAMETER_SOFT_DISTANCE_M = 10,
    FK_PARAMETER_TURN_LEAD = 11,
    FK_PARAMETER_PLAN_TIME_US = 12,
    FK_PARAMETER_TRANSITIONS_MAX = 13,
    FK_PARAMETER_LEARN = 14,
    FK_PARAMETER_WALL_WEIGHT_PER_M = 15,
    FK_PARAMETER_WALL_GLIDE = 16,
    FK_PARAMETER_WALL_X_MIN_M = 17,
    FK_PARAMETER_WALL_X_MAX_M = 18,
    FK_PARAMETER_WALL_Y_MIN_M = 19,
    FK_PARAMETER_WALL_Y_MAX_M = 20,
    FK_PARAMETER_GLIDE_WEIGHT_PER_M = 21,
    FK_PARAMETER_GLIDE_LEAD = 22,
    FK_PARAMETER_COURSE_WEIGHT_PER_M = 23
};

enum { /* whether the robot learns what its limbs have lost */
    FK_LEARN_OFF = 0,
    FK_LEARN_ON = 1,
    FK_LEARN_HELD = 2
};

enum { /* frame types */
    FK_FRAME_HELLO = 0x01,
    FK_FRAME_ARM = 0x02,
    FK_FRAME_DISARM = 0x03,
    FK_FRAME_FIX = 0x04,
    FK_FRAME_PATH = 0x05,
    FK_FRAME_START = 0x06,
    FK_FRAME_STOP = 0x07,
    FK_FRAME_STATUS = 0x08,
    FK_FRAME_PARAM = 0x09,
    FK_FRAME_STROKE = 0x0a,
    FK_FRAME_PLAN = 0x0b,
    FK_FRAME_TABLE_BEGIN = 0x0c,
    FK_FRAME_TABLE_CHUNK = 0x0d,
    FK_FRAME_TABLE_COMMIT = 0x0e,
    FK_FRAME_TABLE_ROLLBACK = 0x0f,
    FK_FRAME_TABLE_STATUS = 0x10,
    FK_FRAME_LOG = 0x11,
    FK_FRAME_CHALLENGE = 0x12,
    FK_FRAME_KEY = 0x13,
    FK_FRAME_DECISION = 0x60,
    FK_FRAME_REFUSED = 0x62,
    FK_FRAME_ENDED = 0x61
};

/* Commands that a robot with an owner's key takes with an authentication code alone. */
static inline int32_t fk_frame_needs_code(uint8_t type)
{
    return type == FK_FRAME_ARM ||
           type == FK_FRAME_FIX ||
           type == FK_FRAME_PATH ||
           type == FK_FRAME_START ||
           type == FK_FRAME_PARAM ||
           type == FK_FRAME_STROKE ||
           type == FK_FRAME_TABLE_BEGIN ||
           type == FK_FRAME_TABLE_CHUNK ||
           type == FK_FRAME_TABLE_COMMIT ||
           type == FK_FRAME_TABLE_ROLLBACK ||
           type == FK_FRAME_KEY;
}

enum { /* records of the log */
    FK_RECORD_BOOT = 1,
    FK_RECORD_COMMAND = 2,
    FK_RECORD_DECISION = 3,
    FK_RECORD_STROKE = 4,
    FK_RECORD_BEGUN = 5,
    FK_RECORD_REFUSED = 6,
    FK_RECORD_DROPPED = 7,
    FK_RECORD_PULSE = 8,
    FK_RECORD_OFF = 9,
    FK_RECORD_STATE = 10,
    FK_RECORD_ENDED = 11,
    FK_RECORD_FAULT = 12,
    FK_RECORD_SNAPSHOT = 13
};

typedef union {
    float value;
    uint32_t bits;
} fk_f32_bits_t;

static inline void fk_put_u8(uint8_t *to, uint8_t value) { to[0] = value; }

static inline void fk_put_i8(uint8_t *to, int8_t value) { to[0] = (uint8_t)value; }

static inline void fk_put_u16(uint8_t *to, uint16_t value)
{
    to[0] = (uint8_t)(value & 0xffu);
    to[1] = (uint8_t)(value >> 8);
}

static inline void fk_put_u32(uint8_t *to, uint32_t value)
{
    fk_put_u16(to, (uint16_t)(value & 0xffffu));
    fk_put_u16(to + 2, (uint16_t)(value >> 16));
}

static inline void fk_put_u64(uint8_t *to, uint64_t value)
{
    fk_put_u32(to, (uint32_t)(value & 0xffffffffu));
    fk_put_u32(to + 4, (uint32_t)(value >> 32));
}

static inline void fk_put_f32(uint8_t *to, float value)
{
    fk_f32_bits_t pun;
    pun.value = value;
    fk_put_u32(to, pun.bits);
}

static inline uint8_t fk_get_u8(const uint8_t *from) { return from[0]; }

static inline uint16_t fk_get_u16(const uint8_t *from)
{
    return (uint16_t)(from[0] | ((uint16_t)from[1] << 8));
}

static inline uint32_t fk_get_u32(const uint8_t *from)
{
    return (uint32_t)fk_get_u16(from) | ((uint32_t)fk_get_u16(from + 2) << 16);
}

static inline float fk_get_f32(const uint8_t *from)
{
    fk_f32_bits_t pun;
    pun.bits = fk_get_u32(from);
    return pun.value;
}

#define FK_HELLO_COMMAND_BYTES 1u

/* Identify robot and table. A HELLO of another protocol version, or with the length of one, is answered with VERSION. */
typedef struct {
    uint8_t protocol_version; /* the host's */
} fk_hello_command_t;

static inline void fk_hello_command_unpack(const uint8_t *from, fk_hello_command_t *to)
{
    to->protocol_version = fk_get_u8(from + 0);
}

#define FK_HELLO_ANSWER_BYTES 35u

/* Answer to HELLO. */
typedef struct {
    int8_t status; /* see status */
    uint8_t protocol_version; /* the robot's */
    char robot_id[16]; /* robot that the table was made for */
    uint32_t table_crc; /* CRC-32 of the table image in use */
    uint16_t states; /* states in the table */
    uint8_t actions; /* actions in the table */
    uint8_t limbs; /* limbs of the robot */
    uint32_t period_us; /* time of one action (us) */
    uint32_t pulse_us; /* heating time of a limb (us) */
    uint8_t newest; /* newest sequence number: the host counts on from it. Not in a refusal */
} fk_hello_answer_t;

static inline void fk_hello_answer_pack(uint8_t *to, const fk_hello_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u8(to + 1, from->protocol_version);
    for (uint32_t i = 0; i < 16u; ++i) {
        to[2u + i] = (uint8_t)from->robot_id[i];
    }
    fk_put_u32(to + 18, from->table_crc);
    fk_put_u16(to + 22, from->states);
    fk_put_u8(to + 24, from->actions);
    fk_put_u8(to + 25, from->limbs);
    fk_put_u32(to + 26, from->period_us);
    fk_put_u32(to + 30, from->pulse_us);
    fk_put_u8(to + 34, from->newest);
}

#define FK_ARM_COMMAND_BYTES 0u
#define FK_ARM_ANSWER_BYTES 2u

/* Answer to ARM. */
typedef struct {
    int8_t status; /* see status */
    uint8_t state; /* see state */
} fk_arm_answer_t;

static inline void fk_arm_answer_pack(uint8_t *to, const fk_arm_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u8(to + 1, from->state);
}

#define FK_DISARM_COMMAND_BYTES 0u
#define FK_DISARM_ANSWER_BYTES 2u

/* Answer to DISARM. */
typedef struct {
    int8_t status; /* see status */
    uint8_t state; /* see state */
} fk_disarm_answer_t;

static inline void fk_disarm_answer_pack(uint8_t *to, const fk_disarm_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u8(to + 1, from->state);
}

#define FK_FIX_COMMAND_BYTES 19u

/* A position fix, world frame. */
typedef struct {
    uint16_t fix_sequence; /* counts fixes: the same one with the same pose is a double */
    uint8_t quality; /* 0 = not to be used */
    uint32_t capture_age_us; /* time from capture to the sending of this frame, at most 2 s, capture after boot (us) */
    float x_m; /* world (m) */
    float y_m; /* world (m) */
    float heading_rad; /* from +x, counter-clockwise (rad) */
} fk_fix_command_t;

static inline void fk_fix_command_unpack(const uint8_t *from, fk_fix_command_t *to)
{
    to->fix_sequence = fk_get_u16(from + 0);
    to->quality = fk_get_u8(from + 2);
    to->capture_age_us = fk_get_u32(from + 3);
    to->x_m = fk_get_f32(from + 7);
    to->y_m = fk_get_f32(from + 11);
    to->heading_rad = fk_get_f32(from + 15);
}

#define FK_FIX_ANSWER_BYTES 11u

/* Answer to FIX. */
typedef struct {
    int8_t status; /* see status */
    uint16_t fix_sequence; /* of the fix answered */
    uint64_t capture_us; /* capture time on the robot's clock (us) */
} fk_fix_answer_t;

static inline void fk_fix_answer_pack(uint8_t *to, const fk_fix_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u16(to + 1, from->fix_sequence);
    fk_put_u64(to + 3, from->capture_us);
}

#define FK_PATH_COMMAND_BYTES 3u

/* A part of the path, which is complete when first + count = total. During a run the parts are collected while the old path is followed. The complete new path takes over without a stop at the next decision that has an estimate of the pose; the robot continues at its nearest point, the first of several equally near ones. Until then, and if a part is missing or refused, the old path is followed; a first part starts a new path. If the run ends earlier, the newest complete path is used for the next START. */
typedef struct {
    uint8_t first; /* index of the first point here */
    uint8_t total; /* points of the whole path, 2 to 100 */
    uint8_t count; /* points here, 1 to 18 */
} fk_path_command_t;

static inline void fk_path_command_unpack(const uint8_t *from, fk_path_command_t *to)
{
    to->first = fk_get_u8(from + 0);
    to->total = fk_get_u8(from + 1);
    to->count = fk_get_u8(from + 2);
}

#define FK_PATH_ROW_BYTES 12u
#define FK_PATH_ROWS_MAX 18u

/* One repeated row of PATH. */
typedef struct {
    float x_m; /* world (m) */
    float y_m; /* world (m) */
    float tangent_rad; /* heading of the path there (rad) */
} fk_path_row_t;

static inline void fk_path_row_unpack(const uint8_t *from, fk_path_row_t *to)
{
    to->x_m = fk_get_f32(from + 0);
    to->y_m = fk_get_f32(from + 4);
    to->tangent_rad = fk_get_f32(from + 8);
}

#define FK_PATH_ANSWER_BYTES 2u

/* Answer to PATH. */
typedef struct {
    int8_t status; /* see status */
    uint8_t received; /* points received so far, in order */
} fk_path_answer_t;

static inline void fk_path_answer_pack(uint8_t *to, const fk_path_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u8(to + 1, from->received);
}

#define FK_START_COMMAND_BYTES 4u

/* Follow the path with the planner on board. Needs a position fix of the last 2 s. */
typedef struct {
    uint32_t delay_us; /* time to the first decision, at most 10 s (us) */
} fk_start_command_t;

static inline void fk_start_command_unpack(const uint8_t *from, fk_start_command_t *to)
{
    to->delay_us = fk_get_u32(from + 0);
}

#define FK_START_ANSWER_BYTES 9u

/* Answer to START. */
typedef struct {
    int8_t status; /* see status */
    uint64_t first_decision_us; /* on the robot's clock (us) */
} fk_start_answer_t;

static inline void fk_start_answer_pack(uint8_t *to, const fk_start_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u64(to + 1, from->first_decision_us);
}

#define FK_STOP_COMMAND_BYTES 0u
#define FK_STOP_ANSWER_BYTES 2u

/* Answer to STOP. */
typedef struct {
    int8_t status; /* see status */
    uint8_t state; /* see state */
} fk_stop_answer_t;

static inline void fk_stop_answer_pack(uint8_t *to, const fk_stop_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u8(to + 1, from->state);
}

#define FK_STATUS_COMMAND_BYTES 0u
#define FK_STATUS_ANSWER_BYTES 72u

/* Answer to STATUS. */
typedef struct {
    int8_t status; /* see status */
    uint8_t state; /* see state */
    uint64_t now_us; /* the robot's clock (us) */
    uint32_t decisions; /* decisions since START */
    uint32_t fixes_used; /* fixes taken since boot */
    uint32_t fixes_refused; /* fixes refused since boot */
    uint32_t frames_bad; /* frames that failed COBS, length or CRC, or were answers or events */
    uint32_t pulses; /* pulses since boot */
    uint32_t pulses_refused; /* pulses that the guard refused, or that the port could not begin in time */
    uint32_t answers_dropped; /* answers and events that found no room, or that the radio could not send */
    uint32_t restarts; /* times that outliers which agree were believed since boot */
    uint32_t repeats; /* commands that came again and were answered, not done, since boot */
    uint8_t reset; /* why the robot started last, see reset */
    uint8_t fault; /* the first internal error since then, see fault */
    int8_t fault_detail; /* see fault */
    uint32_t rest_us; /* how long strokes are still refused because the limbs' heat was unknown at the start; 0 = they are not (us) */
    uint8_t supply; /* see supply */
    uint8_t owner; /* see owner */
    uint8_t learn; /* see learn */
    uint16_t lost_0; /* learned: share that limb 0 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_1; /* learned: share that limb 1 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_2; /* learned: share that limb 2 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_3; /* learned: share that limb 3 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_4; /* learned: share that limb 4 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_5; /* learned: share that limb 5 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_6; /* learned: share that limb 6 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_7; /* learned: share that limb 7 has lost of its contribution, 0 = none to 32767 = all */
} fk_status_answer_t;

static inline void fk_status_answer_pack(uint8_t *to, const fk_status_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u8(to + 1, from->state);
    fk_put_u64(to + 2, from->now_us);
    fk_put_u32(to + 10, from->decisions);
    fk_put_u32(to + 14, from->fixes_used);
    fk_put_u32(to + 18, from->fixes_refused);
    fk_put_u32(to + 22, from->frames_bad);
    fk_put_u32(to + 26, from->pulses);
    fk_put_u32(to + 30, from->pulses_refused);
    fk_put_u32(to + 34, from->answers_dropped);
    fk_put_u32(to + 38, from->restarts);
    fk_put_u32(to + 42, from->repeats);
    fk_put_u8(to + 46, from->reset);
    fk_put_u8(to + 47, from->fault);
    fk_put_i8(to + 48, from->fault_detail);
    fk_put_u32(to + 49, from->rest_us);
    fk_put_u8(to + 53, from->supply);
    fk_put_u8(to + 54, from->owner);
    fk_put_u8(to + 55, from->learn);
    fk_put_u16(to + 56, from->lost_0);
    fk_put_u16(to + 58, from->lost_1);
    fk_put_u16(to + 60, from->lost_2);
    fk_put_u16(to + 62, from->lost_3);
    fk_put_u16(to + 64, from->lost_4);
    fk_put_u16(to + 66, from->lost_5);
    fk_put_u16(to + 68, from->lost_6);
    fk_put_u16(to + 70, from->lost_7);
}

#define FK_PARAM_COMMAND_BYTES 5u

/* Set a planner parameter. Not while running. */
typedef struct {
    uint8_t parameter; /* see parameter */
    float value; /* in the unit of the name */
} fk_param_command_t;

static inline void fk_param_command_unpack(const uint8_t *from, fk_param_command_t *to)
{
    to->parameter = fk_get_u8(from + 0);
    to->value = fk_get_f32(from + 1);
}

#define FK_PARAM_ANSWER_BYTES 1u

/* Answer to PARAM. */
typedef struct {
    int8_t status; /* see status */
} fk_param_answer_t;

static inline void fk_param_answer_pack(uint8_t *to, const fk_param_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
}

#define FK_STROKE_COMMAND_BYTES 1u

/* Begin this action now, with the planner on the host. Refused while a stroke has limbs left to fire. */
typedef struct {
    uint8_t action; /* index in the table's actions */
} fk_stroke_command_t;

static inline void fk_stroke_command_unpack(const uint8_t *from, fk_stroke_command_t *to)
{
    to->action = fk_get_u8(from + 0);
}

#define FK_STROKE_ANSWER_BYTES 9u

/* Answer to STROKE. */
typedef struct {
    int8_t status; /* see status */
    uint64_t stroke_us; /* start on the robot's clock (us) */
} fk_stroke_answer_t;

static inline void fk_stroke_answer_pack(uint8_t *to, const fk_stroke_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u64(to + 1, from->stroke_us);
}

#define FK_PLAN_COMMAND_BYTES 45u

/* Plan for a given state without moving, for parity tests. Not while running. */
typedef struct {
    uint8_t depth; /* 1 to 4 levels */
    float x_m; /* world (m) */
    float y_m; /* world (m) */
    float heading_rad; /* world (rad) */
    float vx_mps; /* body, forward (m/s) */
    float vy_mps; /* body, left (m/s) */
    float omega_rad_s; /* counter-clockwise (rad/s) */
    uint16_t limb_use_0; /* lately used: limb 0, 0 = rested to 32767 = full */
    uint16_t limb_use_1; /* lately used: limb 1, 0 = rested to 32767 = full */
    uint16_t limb_use_2; /* lately used: limb 2, 0 = rested to 32767 = full */
    uint16_t limb_use_3; /* lately used: limb 3, 0 = rested to 32767 = full */
    uint16_t limb_use_4; /* lately used: limb 4, 0 = rested to 32767 = full */
    uint16_t limb_use_5; /* lately used: limb 5, 0 = rested to 32767 = full */
    uint16_t limb_use_6; /* lately used: limb 6, 0 = rested to 32767 = full */
    uint16_t limb_use_7; /* lately used: limb 7, 0 = rested to 32767 = full */
    float along_points; /* where along the path it was last, in points, 0 to the last one */
} fk_plan_command_t;

static inline void fk_plan_command_unpack(const uint8_t *from, fk_plan_command_t *to)
{
    to->depth = fk_get_u8(from + 0);
    to->x_m = fk_get_f32(from + 1);
    to->y_m = fk_get_f32(from + 5);
    to->heading_rad = fk_get_f32(from + 9);
    to->vx_mps = fk_get_f32(from + 13);
    to->vy_mps = fk_get_f32(from + 17);
    to->omega_rad_s = fk_get_f32(from + 21);
    to->limb_use_0 = fk_get_u16(from + 25);
    to->limb_use_1 = fk_get_u16(from + 27);
    to->limb_use_2 = fk_get_u16(from + 29);
    to->limb_use_3 = fk_get_u16(from + 31);
    to->limb_use_4 = fk_get_u16(from + 33);
    to->limb_use_5 = fk_get_u16(from + 35);
    to->limb_use_6 = fk_get_u16(from + 37);
    to->limb_use_7 = fk_get_u16(from + 39);
    to->along_points = fk_get_f32(from + 41);
}

#define FK_PLAN_ANSWER_BYTES 63u

/* Answer to PLAN. */
typedef struct {
    int8_t status; /* see status */
    uint8_t action; /* chosen action */
    uint16_t nearest_state; /* row of the table */
    uint16_t path_index; /* path point nearest to the state; cost route: last one that it has reached */
    uint8_t depth_reached; /* levels that were finished */
    uint32_t transitions; /* transitions evaluated */
    float cost; /* of the best branch */
    float distance_m; /* of the state from the path (m) */
    float along_points; /* where along the path the state is, in points */
    float x_m; /* predicted after the action, world (m) */
    float y_m; /* predicted (m) */
    float heading_rad; /* predicted (rad) */
    float vx_mps; /* predicted, body (m/s) */
    float vy_mps; /* predicted, body (m/s) */
    float omega_rad_s; /* predicted (rad/s) */
    uint16_t limb_use_0; /* predicted use of limb 0, 0 = rested to 32767 = full */
    uint16_t limb_use_1; /* predicted use of limb 1, 0 = rested to 32767 = full */
    uint16_t limb_use_2; /* predicted use of limb 2, 0 = rested to 32767 = full */
    uint16_t limb_use_3; /* predicted use of limb 3, 0 = rested to 32767 = full */
    uint16_t limb_use_4; /* predicted use of limb 4, 0 = rested to 32767 = full */
    uint16_t limb_use_5; /* predicted use of limb 5, 0 = rested to 32767 = full */
    uint16_t limb_use_6; /* predicted use of limb 6, 0 = rested to 32767 = full */
    uint16_t limb_use_7; /* predicted use of limb 7, 0 = rested to 32767 = full */
} fk_plan_answer_t;

static inline void fk_plan_answer_pack(uint8_t *to, const fk_plan_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u8(to + 1, from->action);
    fk_put_u16(to + 2, from->nearest_state);
    fk_put_u16(to + 4, from->path_index);
    fk_put_u8(to + 6, from->depth_reached);
    fk_put_u32(to + 7, from->transitions);
    fk_put_f32(to + 11, from->cost);
    fk_put_f32(to + 15, from->distance_m);
    fk_put_f32(to + 19, from->along_points);
    fk_put_f32(to + 23, from->x_m);
    fk_put_f32(to + 27, from->y_m);
    fk_put_f32(to + 31, from->heading_rad);
    fk_put_f32(to + 35, from->vx_mps);
    fk_put_f32(to + 39, from->vy_mps);
    fk_put_f32(to + 43, from->omega_rad_s);
    fk_put_u16(to + 47, from->limb_use_0);
    fk_put_u16(to + 49, from->limb_use_1);
    fk_put_u16(to + 51, from->limb_use_2);
    fk_put_u16(to + 53, from->limb_use_3);
    fk_put_u16(to + 55, from->limb_use_4);
    fk_put_u16(to + 57, from->limb_use_5);
    fk_put_u16(to + 59, from->limb_use_6);
    fk_put_u16(to + 61, from->limb_use_7);
}

#define FK_TABLE_BEGIN_COMMAND_BYTES 36u

/* Begin to send a table, or continue an interrupted transfer; writes nothing yet. Only if disarmed and rested, as for the other commands of tables; no ARM until TABLE_COMMIT or TABLE_ROLLBACK. */
typedef struct {
    uint32_t length; /* of the image, whole words (byte) */
    uint32_t hash_0; /* SHA-256 of the image: its first four bytes, the first one uppermost */
    uint32_t hash_1; /* SHA-256: bytes 4 to 7 */
    uint32_t hash_2; /* SHA-256: bytes 8 to 11 */
    uint32_t hash_3; /* SHA-256: bytes 12 to 15 */
    uint32_t hash_4; /* SHA-256: bytes 16 to 19 */
    uint32_t hash_5; /* SHA-256: bytes 20 to 23 */
    uint32_t hash_6; /* SHA-256: bytes 24 to 27 */
    uint32_t hash_7; /* SHA-256: bytes 28 to 31 */
} fk_table_begin_command_t;

static inline void fk_table_begin_command_unpack(const uint8_t *from, fk_table_begin_command_t *to)
{
    to->length = fk_get_u32(from + 0);
    to->hash_0 = fk_get_u32(from + 4);
    to->hash_1 = fk_get_u32(from + 8);
    to->hash_2 = fk_get_u32(from + 12);
    to->hash_3 = fk_get_u32(from + 16);
    to->hash_4 = fk_get_u32(from + 20);
    to->hash_5 = fk_get_u32(from + 24);
    to->hash_6 = fk_get_u32(from + 28);
    to->hash_7 = fk_get_u32(from + 32);
}

#define FK_TABLE_BEGIN_ANSWER_BYTES 10u

/* Answer to TABLE_BEGIN. */
typedef struct {
    int8_t status; /* see status */
    int8_t error; /* of status TABLE: the planner's fk_error_t */
    uint32_t next_offset; /* of the chunk wanted next, while an update is open (byte) */
    uint32_t table_crc; /* CRC-32 of the table image in use */
} fk_table_begin_answer_t;

static inline void fk_table_begin_answer_pack(uint8_t *to, const fk_table_begin_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_i8(to + 1, from->error);
    fk_put_u32(to + 2, from->next_offset);
    fk_put_u32(to + 6, from->table_crc);
}

#define FK_TABLE_CHUNK_COMMAND_BYTES 4u

/* 128 bytes of the image, or the rest of it. Written to flash at once; each page is erased before its first chunk. */
typedef struct {
    uint32_t offset; /* of the first byte here, as the last answer wanted it (byte) */
} fk_table_chunk_command_t;

static inline void fk_table_chunk_command_unpack(const uint8_t *from, fk_table_chunk_command_t *to)
{
    to->offset = fk_get_u32(from + 0);
}

#define FK_TABLE_CHUNK_ROW_BYTES 1u
#define FK_TABLE_CHUNK_ROWS_MAX 128u

/* One repeated row of TABLE_CHUNK. */
typedef struct {
    uint8_t byte; /* of the image */
} fk_table_chunk_row_t;

static inline void fk_table_chunk_row_unpack(const uint8_t *from, fk_table_chunk_row_t *to)
{
    to->byte = fk_get_u8(from + 0);
}

#define FK_TABLE_CHUNK_ANSWER_BYTES 10u

/* Answer to TABLE_CHUNK. */
typedef struct {
    int8_t status; /* see status */
    int8_t error; /* of status TABLE: the planner's fk_error_t */
    uint32_t next_offset; /* of the chunk wanted next, while an update is open (byte) */
    uint32_t table_crc; /* CRC-32 of the table image in use */
} fk_table_chunk_answer_t;

static inline void fk_table_chunk_answer_pack(uint8_t *to, const fk_table_chunk_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_i8(to + 1, from->error);
    fk_put_u32(to + 2, from->next_offset);
    fk_put_u32(to + 6, from->table_crc);
}

#define FK_TABLE_COMMIT_COMMAND_BYTES 0u
#define FK_TABLE_COMMIT_ANSWER_BYTES 10u

/* Answer to TABLE_COMMIT. */
typedef struct {
    int8_t status; /* see status */
    int8_t error; /* of status TABLE: the planner's fk_error_t */
    uint32_t next_offset; /* of the chunk wanted next, while an update is open (byte) */
    uint32_t table_crc; /* CRC-32 of the table image in use */
} fk_table_commit_answer_t;

static inline void fk_table_commit_answer_pack(uint8_t *to, const fk_table_commit_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_i8(to + 1, from->error);
    fk_put_u32(to + 2, from->next_offset);
    fk_put_u32(to + 6, from->table_crc);
}

#define FK_TABLE_ROLLBACK_COMMAND_BYTES 4u

/* Use a stored table from now on: the previous or the built-in one. Closes an open update; nothing else happens if the table is in use already. */
typedef struct {
    uint32_t table_crc; /* CRC-32 of that table, as TABLE_STATUS has it */
} fk_table_rollback_command_t;

static inline void fk_table_rollback_command_unpack(const uint8_t *from, fk_table_rollback_command_t *to)
{
    to->table_crc = fk_get_u32(from + 0);
}

#define FK_TABLE_ROLLBACK_ANSWER_BYTES 10u

/* Answer to TABLE_ROLLBACK. */
typedef struct {
    int8_t status; /* see status */
    int8_t error; /* of status TABLE: the planner's fk_error_t */
    uint32_t next_offset; /* of the chunk wanted next, while an update is open (byte) */
    uint32_t table_crc; /* CRC-32 of the table image in use */
} fk_table_rollback_answer_t;

static inline void fk_table_rollback_answer_pack(uint8_t *to, const fk_table_rollback_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_i8(to + 1, from->error);
    fk_put_u32(to + 2, from->next_offset);
    fk_put_u32(to + 6, from->table_crc);
}

#define FK_TABLE_STATUS_COMMAND_BYTES 0u
#define FK_TABLE_STATUS_ANSWER_BYTES 42u

/* Answer to TABLE_STATUS. */
typedef struct {
    int8_t status; /* see status */
    uint8_t running; /* table in use */
    uint8_t active; /* table that was to be in use: another one where it was not good at boot */
    uint8_t previous; /* table before that */
    uint8_t open; /* 1 = an update takes chunks */
    uint8_t slots; /* slots for tables, 1 or 2 */
    uint32_t slot_bytes; /* room in each (byte) */
    uint32_t running_crc; /* CRC-32 of the table in use */
    uint32_t previous_crc; /* CRC-32 of the table before it */
    uint32_t built_in_crc; /* CRC-32 of the built-in table */
    uint32_t next_offset; /* of the chunk wanted next, while an update is open (byte) */
    uint32_t erases_1; /* times that pages of slot 1 were erased, at most, of 10,000 */
    uint32_t erases_2; /* the same of slot 2 */
    uint32_t erases_journal; /* of the journal's two pages together */
    uint32_t repairs; /* starts that found the journal's newest entry damaged or cut short, and wrote it anew */
} fk_table_status_answer_t;

static inline void fk_table_status_answer_pack(uint8_t *to, const fk_table_status_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u8(to + 1, from->running);
    fk_put_u8(to + 2, from->active);
    fk_put_u8(to + 3, from->previous);
    fk_put_u8(to + 4, from->open);
    fk_put_u8(to + 5, from->slots);
    fk_put_u32(to + 6, from->slot_bytes);
    fk_put_u32(to + 10, from->running_crc);
    fk_put_u32(to + 14, from->previous_crc);
    fk_put_u32(to + 18, from->built_in_crc);
    fk_put_u32(to + 22, from->next_offset);
    fk_put_u32(to + 26, from->erases_1);
    fk_put_u32(to + 30, from->erases_2);
    fk_put_u32(to + 34, from->erases_journal);
    fk_put_u32(to + 38, from->repairs);
}

#define FK_LOG_COMMAND_BYTES 4u

/* Records of the robot's log from an offset on, or from the oldest record on if the offset was overwritten. */
typedef struct {
    uint32_t offset; /* where to read: 0 at first, then behind what has come (byte) */
} fk_log_command_t;

static inline void fk_log_command_unpack(const uint8_t *from, fk_log_command_t *to)
{
    to->offset = fk_get_u32(from + 0);
}

#define FK_LOG_ANSWER_BYTES 17u
#define FK_LOG_ANSWER_ROWS_MAX 208u /* of 1 bytes */

/* Answer to LOG. */
typedef struct {
    int8_t status; /* see status */
    uint32_t offset; /* of the first byte here (byte) */
    uint32_t begin; /* of the oldest record that is there (byte) */
    uint32_t end; /* behind the newest record (byte) */
    uint32_t lost; /* records overwritten since the log began */
} fk_log_answer_t;

static inline void fk_log_answer_pack(uint8_t *to, const fk_log_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u32(to + 1, from->offset);
    fk_put_u32(to + 5, from->begin);
    fk_put_u32(to + 9, from->end);
    fk_put_u32(to + 13, from->lost);
}

#define FK_CHALLENGE_COMMAND_BYTES 16u

/* Offer an authenticated conversation: the robot proves that it has the owner's key. The conversation begins with its first command, within 5 s. Not while running. */
typedef struct {
    uint32_t nonce_0; /* the host's: 16 bytes that it never used before, bytes 0 to 3 */
    uint32_t nonce_1; /* bytes 4 to 7 */
    uint32_t nonce_2; /* bytes 8 to 11 */
    uint32_t nonce_3; /* bytes 12 to 15 */
} fk_challenge_command_t;

static inline void fk_challenge_command_unpack(const uint8_t *from, fk_challenge_command_t *to)
{
    to->nonce_0 = fk_get_u32(from + 0);
    to->nonce_1 = fk_get_u32(from + 4);
    to->nonce_2 = fk_get_u32(from + 8);
    to->nonce_3 = fk_get_u32(from + 12);
}

#define FK_CHALLENGE_ANSWER_BYTES 33u

/* Answer to CHALLENGE. */
typedef struct {
    int8_t status; /* see status */
    uint32_t nonce_0; /* the robot's, the same until a conversation begins or ends, or for 5 s: bytes 0 to 3 */
    uint32_t nonce_1; /* bytes 4 to 7 */
    uint32_t nonce_2; /* bytes 8 to 11 */
    uint32_t nonce_3; /* bytes 12 to 15 */
    uint32_t proof_0; /* its proof, 16 bytes: bytes 0 to 3 */
    uint32_t proof_1; /* bytes 4 to 7 */
    uint32_t proof_2; /* bytes 8 to 11 */
    uint32_t proof_3; /* bytes 12 to 15 */
} fk_challenge_answer_t;

static inline void fk_challenge_answer_pack(uint8_t *to, const fk_challenge_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u32(to + 1, from->nonce_0);
    fk_put_u32(to + 5, from->nonce_1);
    fk_put_u32(to + 9, from->nonce_2);
    fk_put_u32(to + 13, from->nonce_3);
    fk_put_u32(to + 17, from->proof_0);
    fk_put_u32(to + 21, from->proof_1);
    fk_put_u32(to + 25, from->proof_2);
    fk_put_u32(to + 29, from->proof_3);
}

#define FK_KEY_COMMAND_BYTES 32u

/* Set the owner's key of the robot; 32 zeros remove it. Only if disarmed and rested, with no update of the table open. Ends all authenticated conversations. */
typedef struct {
    uint32_t key_0; /* bytes 0 to 3 */
    uint32_t key_1; /* bytes 4 to 7 */
    uint32_t key_2; /* bytes 8 to 11 */
    uint32_t key_3; /* bytes 12 to 15 */
    uint32_t key_4; /* bytes 16 to 19 */
    uint32_t key_5; /* bytes 20 to 23 */
    uint32_t key_6; /* bytes 24 to 27 */
    uint32_t key_7; /* bytes 28 to 31 */
} fk_key_command_t;

static inline void fk_key_command_unpack(const uint8_t *from, fk_key_command_t *to)
{
    to->key_0 = fk_get_u32(from + 0);
    to->key_1 = fk_get_u32(from + 4);
    to->key_2 = fk_get_u32(from + 8);
    to->key_3 = fk_get_u32(from + 12);
    to->key_4 = fk_get_u32(from + 16);
    to->key_5 = fk_get_u32(from + 20);
    to->key_6 = fk_get_u32(from + 24);
    to->key_7 = fk_get_u32(from + 28);
}

#define FK_KEY_ANSWER_BYTES 1u

/* Answer to KEY. */
typedef struct {
    int8_t status; /* see status */
} fk_key_answer_t;

static inline void fk_key_answer_pack(uint8_t *to, const fk_key_answer_t *from)
{
    fk_put_i8(to + 0, from->status);
}

#define FK_DECISION_EVENT_BYTES 122u

/* A decision of the planner on board. */
typedef struct {
    int8_t status; /* OK, or why the action is the resting one */
    uint8_t action; /* index in the table's actions */
    uint32_t decision; /* counts from 0 at START */
    uint64_t scheduled_us; /* decision time on the robot's clock; the estimate is for this time (us) */
    uint16_t fix_sequence; /* newest fix in the estimate */
    uint8_t fixes_in_estimate; /* fixes that the estimate rests on, 255 = or more */
    uint16_t path_index; /* path point nearest to the estimate; cost route: last one that it has reached */
    uint8_t depth_reached; /* levels that were finished */
    uint32_t transitions; /* transitions evaluated */
    uint16_t nearest_state; /* row of the table */
    uint32_t plan_us; /* computing time of the decision (us) */
    float cost; /* of the best branch */
    float distance_m; /* of the estimate from the path (m) */
    float along_points; /* where along the path the estimate is, in points */
    float x_m; /* estimate, world (m) */
    float y_m; /* estimate, world (m) */
    float heading_rad; /* estimate, world (rad) */
    float vx_mps; /* estimate, body (m/s) */
    float vy_mps; /* estimate, body (m/s) */
    float omega_rad_s; /* estimate (rad/s) */
    uint16_t limb_use_0; /* lately used: limb 0, 0 = rested to 32767 = full */
    uint16_t limb_use_1; /* lately used: limb 1, 0 = rested to 32767 = full */
    uint16_t limb_use_2; /* lately used: limb 2, 0 = rested to 32767 = full */
    uint16_t limb_use_3; /* lately used: limb 3, 0 = rested to 32767 = full */
    uint16_t limb_use_4; /* lately used: limb 4, 0 = rested to 32767 = full */
    uint16_t limb_use_5; /* lately used: limb 5, 0 = rested to 32767 = full */
    uint16_t limb_use_6; /* lately used: limb 6, 0 = rested to 32767 = full */
    uint16_t limb_use_7; /* lately used: limb 7, 0 = rested to 32767 = full */
    uint16_t lost_0; /* learned: share that limb 0 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_1; /* learned: share that limb 1 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_2; /* learned: share that limb 2 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_3; /* learned: share that limb 3 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_4; /* learned: share that limb 4 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_5; /* learned: share that limb 5 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_6; /* learned: share that limb 6 has lost of its contribution, 0 = none to 32767 = all */
    uint16_t lost_7; /* learned: share that limb 7 has lost of its contribution, 0 = none to 32767 = all */
    float predicted_x_m; /* after the action, world (m) */
    float predicted_y_m; /* after the action, world (m) */
    float predicted_heading_rad; /* after the action (rad) */
    float predicted_vx_mps; /* after the action, body (m/s) */
    float predicted_vy_mps; /* after the action, body (m/s) */
    float predicted_omega_rad_s; /* after the action (rad/s) */
} fk_decision_event_t;

static inline void fk_decision_event_pack(uint8_t *to, const fk_decision_event_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u8(to + 1, from->action);
    fk_put_u32(to + 2, from->decision);
    fk_put_u64(to + 6, from->scheduled_us);
    fk_put_u16(to + 14, from->fix_sequence);
    fk_put_u8(to + 16, from->fixes_in_estimate);
    fk_put_u16(to + 17, from->path_index);
    fk_put_u8(to + 19, from->depth_reached);
    fk_put_u32(to + 20, from->transitions);
    fk_put_u16(to + 24, from->nearest_state);
    fk_put_u32(to + 26, from->plan_us);
    fk_put_f32(to + 30, from->cost);
    fk_put_f32(to + 34, from->distance_m);
    fk_put_f32(to + 38, from->along_points);
    fk_put_f32(to + 42, from->x_m);
    fk_put_f32(to + 46, from->y_m);
    fk_put_f32(to + 50, from->heading_rad);
    fk_put_f32(to + 54, from->vx_mps);
    fk_put_f32(to + 58, from->vy_mps);
    fk_put_f32(to + 62, from->omega_rad_s);
    fk_put_u16(to + 66, from->limb_use_0);
    fk_put_u16(to + 68, from->limb_use_1);
    fk_put_u16(to + 70, from->limb_use_2);
    fk_put_u16(to + 72, from->limb_use_3);
    fk_put_u16(to + 74, from->limb_use_4);
    fk_put_u16(to + 76, from->limb_use_5);
    fk_put_u16(to + 78, from->limb_use_6);
    fk_put_u16(to + 80, from->limb_use_7);
    fk_put_u16(to + 82, from->lost_0);
    fk_put_u16(to + 84, from->lost_1);
    fk_put_u16(to + 86, from->lost_2);
    fk_put_u16(to + 88, from->lost_3);
    fk_put_u16(to + 90, from->lost_4);
    fk_put_u16(to + 92, from->lost_5);
    fk_put_u16(to + 94, from->lost_6);
    fk_put_u16(to + 96, from->lost_7);
    fk_put_f32(to + 98, from->predicted_x_m);
    fk_put_f32(to + 102, from->predicted_y_m);
    fk_put_f32(to + 106, from->predicted_heading_rad);
    fk_put_f32(to + 110, from->predicted_vx_mps);
    fk_put_f32(to + 114, from->predicted_vy_mps);
    fk_put_f32(to + 118, from->predicted_omega_rad_s);
}

#define FK_REFUSED_EVENT_BYTES 9u

/* The guard refused the stroke of a decision or a STROKE, or the port was too late for it; the robot rests instead. Of a stroke whose first limbs have fired only the second ones can be refused: `pulses_refused` counts that, and no event tells it. */
typedef struct {
    uint8_t action; /* that was to begin */
    uint64_t begin_us; /* when, on the robot's clock (us) */
} fk_refused_event_t;

static inline void fk_refused_event_pack(uint8_t *to, const fk_refused_event_t *from)
{
    fk_put_u8(to + 0, from->action);
    fk_put_u64(to + 1, from->begin_us);
}

#define FK_ENDED_EVENT_BYTES 6u

/* The run on board ended. */
typedef struct {
    int8_t status; /* OK = path completed; PASSED, STALLED; STALE = no fixes; SUPPLY */
    uint8_t state; /* see state */
    uint32_t decisions; /* decisions taken */
} fk_ended_event_t;

static inline void fk_ended_event_pack(uint8_t *to, const fk_ended_event_t *from)
{
    fk_put_i8(to + 0, from->status);
    fk_put_u8(to + 1, from->state);
    fk_put_u32(to + 2, from->decisions);
}

#define FK_BOOT_RECORD_BYTES 10u

/* The robot started. */
typedef struct {
    uint8_t continued; /* 1 = what stands before it is from before the reset */
    uint8_t reset; /* see reset */
    uint32_t table_crc; /* CRC-32 of the table in use */
    uint32_t rest_us; /* how long strokes are refused because the limbs' heat is unknown; 0 = the guard's history survived the reset (us) */
} fk_boot_record_t;

static inline void fk_boot_record_pack(uint8_t *to, const fk_boot_record_t *from)
{
    fk_put_u8(to + 0, from->continued);
    fk_put_u8(to + 1, from->reset);
    fk_put_u32(to + 2, from->table_crc);
    fk_put_u32(to + 6, from->rest_us);
}

#define FK_COMMAND_RECORD_BYTES 1u

/* A command that changes something was received; its effects follow. Not logged in FAULT, and a FIX not while disarmed. */
typedef struct {
    uint8_t type; /* id of its frame */
} fk_command_record_t;

static inline void fk_command_record_pack(uint8_t *to, const fk_command_record_t *from)
{
    fk_put_u8(to + 0, from->type);
}

#define FK_STROKE_RECORD_BYTES 9u

/* An action is requested, by a decision or STROKE. */
typedef struct {
    uint8_t action; /* index in the table's actions */
    uint64_t begin_us; /* when it is to begin, on the robot's clock (us) */
} fk_stroke_record_t;

static inline void fk_stroke_record_pack(uint8_t *to, const fk_stroke_record_t *from)
{
    fk_put_u8(to + 0, from->action);
    fk_put_u64(to + 1, from->begin_us);
}

#define FK_PULSE_RECORD_BYTES 6u

/* Limbs were to be switched on now. */
typedef struct {
    uint8_t limb_mask; /* bit i = limb i */
    uint8_t allowed; /* 1 = the port was asked to, 0 = the guard refused it, 2 = the port was too late and did not begin it */
    uint32_t pulse_us; /* length (us) */
} fk_pulse_record_t;

static inline void fk_pulse_record_pack(uint8_t *to, const fk_pulse_record_t *from)
{
    fk_put_u8(to + 0, from->limb_mask);
    fk_put_u8(to + 1, from->allowed);
    fk_put_u32(to + 2, from->pulse_us);
}

#define FK_OFF_RECORD_BYTES 0u
#define FK_STATE_RECORD_BYTES 3u

/* The state changed. */
typedef struct {
    uint8_t before; /* see state */
    uint8_t state; /* see state */
    uint8_t event; /* what led to it: its number in the supervisor's table, from 1; of a command its id */
} fk_state_record_t;

static inline void fk_state_record_pack(uint8_t *to, const fk_state_record_t *from)
{
    fk_put_u8(to + 0, from->before);
    fk_put_u8(to + 1, from->state);
    fk_put_u8(to + 2, from->event);
}

#define FK_FAULT_RECORD_BYTES 2u

/* An internal error, also one that was found at a start. */
typedef struct {
    uint8_t fault; /* see fault */
    int8_t detail; /* see fault */
} fk_fault_record_t;

static inline void fk_fault_record_pack(uint8_t *to, const fk_fault_record_t *from)
{
    fk_put_u8(to + 0, from->fault);
    fk_put_i8(to + 1, from->detail);
}

#define FK_SNAPSHOT_RECORD_BYTES 7u

/* A part of the robot's whole state, from which all later decisions can be repeated. */
typedef struct {
    uint8_t part; /* counts from 0 */
    uint8_t last; /* 1 = the state is whole with it */
    uint8_t anew; /* 1 = something was not logged before it; 0 = it follows from what was */
    uint32_t table_crc; /* CRC-32 of the table in use */
} fk_snapshot_record_t;

static inline void fk_snapshot_record_pack(uint8_t *to, const fk_snapshot_record_t *from)
{
    fk_put_u8(to + 0, from->part);
    fk_put_u8(to + 1, from->last);
    fk_put_u8(to + 2, from->anew);
    fk_put_u32(to + 3, from->table_crc);
}

#endif
