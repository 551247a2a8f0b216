/* The commands of the link, one function for each, which writes its answer's payload. fk_robot_command() calls the
 * right one. */
#include "fk_robot_state.h"

/* most < 2^24, so that both limits and every number between them are exact as float. */
static int32_t is_whole_within(float value, uint32_t least, uint32_t most)
{
    return fk_is_finite_within(value, (float)least, (float)most) && (float)(uint32_t)value == value;
}

static int32_t answer_state(const fk_robot_t *robot, int8_t status, uint8_t *answer)
{
    fk_arm_answer_t reply = {status, robot->state}; /* ARM, DISARM and STOP share this answer */
    fk_arm_answer_pack(answer, &reply);
    return (int32_t)FK_ARM_ANSWER_BYTES;
}

static int32_t answer_status(int8_t status, uint8_t *answer)
{
    fk_put_i8(answer, status);
    return 1;
}

/* HELLO of any length: its first byte is the version in every protocol from 2 on; version 1 had none. */
static int32_t on_hello(const fk_robot_t *robot, const fk_frame_t *frame, uint8_t *answer)
{
    fk_hello_answer_t reply;
    reply.status = FK_STATUS_VERSION;
    if (frame->payload_length == FK_HELLO_COMMAND_BYTES && frame->payload[0] == FK_PROTOCOL_VERSION) {
        reply.status = FK_STATUS_OK;
    }
    reply.protocol_version = FK_PROTOCOL_VERSION;
    for (uint32_t i = 0u; i < 16u; ++i) {
        reply.robot_id[i] = robot->tables.robot_id[i];
    }
    reply.table_crc = robot->tables.image_crc32;
    reply.states = robot->tables.states;
    reply.actions = robot->tables.actions;
    reply.limbs = robot->tables.limbs;
    reply.period_us = robot->period_us;
    reply.pulse_us = robot->tables.pulse_us;
    reply.newest = robot->duplicates.newest;
    fk_hello_answer_pack(answer, &reply);
    /* Protocols up to 6 have the answer without its last field, and their hosts shall understand the refusal. */
    return (int32_t)FK_HELLO_ANSWER_BYTES - (reply.status == FK_STATUS_OK ? 0 : 1);
}

static int32_t on_arm(fk_robot_t *robot, uint8_t *answer)
{
    int8_t status = fk_robot_may(robot, FK_EVENT_ARM);
    if (robot->store != 0 && robot->store->open != 0u) {
        status = FK_STATUS_STATE; /* flash is written with all limbs off */
    } else if (status == FK_STATUS_OK && robot->supply == FK_SUPPLY_LOW) {
        status = FK_STATUS_SUPPLY;
    } else {
        status = fk_robot_supervise(robot, FK_EVENT_ARM);
        robot->supply = (status == FK_STATUS_OK) ? (uint8_t)FK_SUPPLY_OK : robot->supply;
    }
    return answer_state(robot, status, answer);
}

static int32_t on_fix(fk_robot_t *robot, const uint8_t *payload, uint64_t now_us, uint8_t *answer)
{
    fk_fix_command_t command;
    fk_fix_command_unpack(payload, &command);
    fk_fix_answer_t reply = {fk_robot_may(robot, FK_EVENT_FIX), command.fix_sequence, 0u};
    if (reply.status != FK_STATUS_OK) {
        fk_fix_answer_pack(answer, &reply);
        return (int32_t)FK_FIX_ANSWER_BYTES;
    }
    reply.status = FK_STATUS_VALUE;
    /* A picture from before the robot's clock began has no capture time. */
    if (command.quality != 0u && command.capture_age_us <= FK_CAPTURE_AGE_MAX_US && command.capture_age_us <= now_us) {
        uint64_t capture_us = now_us - command.capture_age_us;
        fk_fix_t fix = {capture_us, {command.x_m, command.y_m, command.heading_rad}, command.fix_sequence};
        reply.status = (int8_t)fk_estimator_add(&robot->estimator, &fix);
        reply.capture_us = capture_us;
    }
    if (reply.status == FK_STATUS_OK) {
        fk_robot_note_fix(robot, reply.capture_us, command.x_m, command.y_m);
        ++robot->fixes_used;
    } else {
        ++robot->fixes_refused;
    }
    fk_fix_answer_pack(answer, &reply);
    return (int32_t)FK_FIX_ANSWER_BYTES;
}

static int32_t on_start(fk_robot_t *robot, const uint8_t *payload, uint64_t now_us, uint8_t *answer)
{
    fk_start_command_t command;
    fk_start_command_unpack(payload, &command);
    fk_start_answer_t reply = {fk_robot_may(robot, FK_EVENT_START), 0u};
    if (reply.status != FK_STATUS_OK) {
        /* refused */
    } else if (command.delay_us > FK_START_DELAY_MAX_US) {
        reply.status = FK_STATUS_VALUE;
    } else if (robot->path.count == 0u) {
        reply.status = FK_STATUS_NO_PATH;
    } else if (now_us >= fk_guard_lost_us(&robot->guard)) {
        reply.status = FK_STATUS_STALE;
    } else {
        (void)fk_robot_supervise(robot, FK_EVENT_START);
        robot->decisions = 0u;
        fk_follow_begin(&robot->follow);
        robot->next_decision_us = now_us + command.delay_us;
        reply.first_decision_us = robot->next_decision_us;
    }
    fk_start_answer_pack(answer, &reply);
    return (int32_t)FK_START_ANSWER_BYTES;
}

static int32_t on_status(const fk_robot_t *robot, uint64_t now_us, uint8_t *answer)
{
    fk_status_answer_t reply;
    reply.status = FK_STATUS_OK;
    reply.state = robot->state;
    reply.now_us = now_us;
    reply.decisions = robot->decisions;
    reply.fixes_used = robot->fixes_used;
    reply.fixes_refused = robot->fixes_refused;
    reply.frames_bad = robot->frames_bad;
    reply.pulses = robot->pulses;
    reply.pulses_refused = robot->pulses_refused;
    reply.answers_dropped = robot->answers_dropped;
    reply.restarts = robot->estimator.restarts;
    reply.repeats = robot->commands_repeated;
    reply.reset = robot->reset;
    reply.fault = robot->fault;
    reply.fault_detail = robot->fault_detail;
    reply.rest_us = fk_robot_rest_us(robot);
    reply.supply = robot->supply;
    reply.owner = fk_robot_is_owned(robot) ? (uint8_t)FK_OWNER_KEY : (uint8_t)FK_OWNER_OPEN;
    reply.learn = robot->estimator.track.wear.learn;
    reply.lost_0 = robot->estimator.track.wear.lost[0];
    reply.lost_1 = robot->estimator.track.wear.lost[1];
    reply.lost_2 = robot->estimator.track.wear.lost[2];
    reply.lost_3 = robot->estimator.track.wear.lost[3];
    reply.lost_4 = robot->estimator.track.wear.lost[4];
    reply.lost_5 = robot->estimator.track.wear.lost[5];
    reply.lost_6 = robot->estimator.track.wear.lost[6];
    reply.lost_7 = robot->estimator.track.wear.lost[7];
    fk_status_answer_pack(answer, &reply);
    return (int32_t)FK_STATUS_ANSWER_BYTES;
}

#define ID(name, NAME, least, most) FK_PARAMETER_##NAME,
#define PLACE(name, NAME, least, most) &plan->name,
#define LEAST(name, NAME, least, most) least,
#define MOST(name, NAME, least, most) most,

/* A table instead of a switch: compilers turn a switch into a computed jump, which the stack analysis cannot
 * follow. */
static int8_t set_weight(fk_plan_config_t *plan, uint8_t parameter, float value)
{
    static const uint8_t ids[] = {FK_PLAN_WEIGHTS(ID)};
    static const float least[sizeof(ids)] = {FK_PLAN_WEIGHTS(LEAST)};
    static const float most[sizeof(ids)] = {FK_PLAN_WEIGHTS(MOST)};
    float *const weights[sizeof(ids)] = {FK_PLAN_WEIGHTS(PLACE)};
    for (uint32_t i = 0u; i < sizeof(ids); ++i) {
        if (ids[i] == parameter && fk_is_finite_within(value, least[i], most[i])) {
            *weights[i] = value + 0.0f; /* -0.0, which fk_plan() refuses, becomes 0 */
            return FK_STATUS_OK;
        }
    }
    return FK_STATUS_VALUE;
}

static int8_t set_parameter(fk_robot_t *robot, uint8_t parameter, float value)
{
    int8_t refusal = fk_robot_may(robot, FK_EVENT_PARAM);
    if (refusal != FK_STATUS_OK) {
        return refusal;
    }
    if (parameter == FK_PARAMETER_DEPTH) {
        if (!is_whole_within(value, 1u, FK_DEPTH_MAX)) {
            return FK_STATUS_VALUE;
        }
        robot->plan.depth = (uint8_t)value;
        return FK_STATUS_OK;
    }
    if (parameter == FK_PARAMETER_PERIOD_US) {
        if (!is_whole_within(value, FK_PERIOD_MIN_US, FK_PERIOD_MAX_US) ||
            (uint32_t)value < fk_fit_stroke_us(&robot->tables)) {
            return FK_STATUS_VALUE;
        }
        robot->period_us = (uint32_t)value;
        return FK_STATUS_OK;
    }
    if (parameter == FK_PARAMETER_COST) {
        if (!is_whole_within(value, 0u, FK_COST_LAST)) {
            return FK_STATUS_VALUE;
        }
        robot->plan.cost = (uint8_t)value;
        return FK_STATUS_OK;
    }
    if (parameter == FK_PARAMETER_PLAN_TIME_US) {
        if (!is_whole_within(value, 0u, FK_PLAN_TIME_MAX_US)) {
            return FK_STATUS_VALUE;
        }
        robot->plan.transitions_max = fk_robot_transitions_within((uint32_t)value);
        return FK_STATUS_OK;
    }
    if (parameter == FK_PARAMETER_TRANSITIONS_MAX) {
        if (!is_whole_within(value, 0u, FK_TRANSITIONS_LIMIT)) {
            return FK_STATUS_VALUE;
        }
        robot->plan.transitions_max = fk_robot_transitions_within(0u);
        if (value > 0.0f && (uint32_t)value < robot->plan.transitions_max) {
            robot->plan.transitions_max = (uint32_t)value;
        }
        return FK_STATUS_OK;
    }
    if (parameter == FK_PARAMETER_LEARN) {
        if (!is_whole_within(value, FK_LEARN_OFF, FK_LEARN_HELD) ||
            (value != 0.0f && robot->tables.wear_knots == 0u)) {
            return FK_STATUS_VALUE;
        }
        fk_estimator_learn(&robot->estimator, (uint8_t)value);
        if (value != (float)FK_LEARN_ON) {
            fk_estimator_restart(&robot->estimator);
        }
        return FK_STATUS_OK;
    }
    return set_weight(&robot->plan, parameter, value);
}

static int32_t on_param(fk_robot_t *robot, const uint8_t *payload, uint8_t *answer)
{
    fk_param_command_t command;
    fk_param_command_unpack(payload, &command);
    return answer_status(set_parameter(robot, command.parameter, command.value), answer);
}

static int32_t on_stroke(fk_robot_t *robot, const uint8_t *payload, uint64_t now_us, uint8_t *answer)
{
    fk_stroke_command_t command;
    fk_stroke_command_unpack(payload, &command);
    fk_stroke_answer_t reply = {fk_robot_may(robot, FK_EVENT_STROKE),
                               (robot->free_us > now_us) ? robot->free_us : now_us};
    if (reply.status != FK_STATUS_OK) {
        /* refused */
    } else if (robot->stroke_request != 0u || robot->second_mask != 0u) {
        reply.status = FK_STATUS_STATE; /* the last stroke has not yet fired all of its limbs */
    } else if (command.action >= robot->tables.actions) {
        reply.status = FK_STATUS_VALUE;
    } else {
        fk_robot_ask_stroke(robot, command.action, reply.stroke_us);
    }
    fk_stroke_answer_pack(answer, &reply);
    return (int32_t)FK_STROKE_ANSWER_BYTES;
}

static int32_t on_plan(const fk_robot_t *robot, const uint8_t *payload, uint8_t *answer)
{
    fk_plan_command_t command;
    fk_plan_command_unpack(payload, &command);
    fk_plan_answer_t reply = {FK_STATUS_OK, 0u,   0u,   0u,   0u,   0u,   0.0f, 0.0f, 0.0f, 0.0f, 0.0f,
                             0.0f,         0.0f, 0.0f, 0.0f, 0u,   0u,   0u,   0u,   0u,   0u,   0u,   0u};
    reply.status = fk_robot_may(robot, FK_EVENT_PLAN);
    if (reply.status != FK_STATUS_OK) {
        /* refused */
    } else if (robot->path.count == 0u) {
        reply.status = FK_STATUS_NO_PATH;
    } else {
        fk_state_t state = {command.x_m,    command.y_m,    command.heading_rad,
                            command.vx_mps, command.vy_mps, command.omega_rad_s,
                            {command.limb_use_0, command.limb_use_1, command.limb_use_2, command.limb_use_3,
                             command.limb_use_4, command.limb_use_5, command.limb_use_6, command.limb_use_7},
                            command.along_points};
        fk_plan_t plan;
        reply.status = (int8_t)fk_robot_plan(robot, command.depth, &state, &plan);
        if (reply.status == FK_STATUS_OK) {
            reply.action = plan.action;
            reply.nearest_state = plan.nearest_state;
            reply.path_index = plan.path_index;
            reply.depth_reached = plan.depth_reached;
            reply.transitions = plan.transitions;
            reply.cost = plan.cost;
            reply.distance_m = plan.distance_m;
            reply.along_points = plan.along_points;
            reply.x_m = plan.predicted.x_m;
            reply.y_m = plan.predicted.y_m;
            reply.heading_rad = plan.predicted.heading_rad;
            reply.vx_mps = plan.predicted.vx_mps;
            reply.vy_mps = plan.predicted.vy_mps;
            reply.omega_rad_s = plan.predicted.omega_rad_s;
            reply.limb_use_0 = plan.predicted.limb_use[0];
            reply.limb_use_1 = plan.predicted.limb_use[1];
            reply.limb_use_2 = plan.predicted.limb_use[2];
            reply.limb_use_3 = plan.predicted.limb_use[3];
            reply.limb_use_4 = plan.predicted.limb_use[4];
            reply.limb_use_5 = plan.predicted.limb_use[5];
            reply.limb_use_6 = plan.predicted.limb_use[6];
            reply.limb_use_7 = plan.predicted.limb_use[7];
        }
    }
    fk_plan_answer_pack(answer, &reply);
    return (int32_t)FK_PLAN_ANSWER_BYTES;
}

/* Payload length of each command; HELLO and PATH check their own. */
static int32_t length_fits(const fk_frame_t *frame)
{
    switch (frame->type) {
    case FK_FRAME_HELLO:
        return 1;
    case FK_FRAME_FIX:
        return frame->payload_length == FK_FIX_COMMAND_BYTES;
    case FK_FRAME_PATH:
        return frame->payload_length >= FK_PATH_COMMAND_BYTES;
    case FK_FRAME_START:
        return frame->payload_length == FK_START_COMMAND_BYTES;
    case FK_FRAME_PARAM:
        return frame->payload_length == FK_PARAM_COMMAND_BYTES;
    case FK_FRAME_STROKE:
        return frame->payload_length == FK_STROKE_COMMAND_BYTES;
    case FK_FRAME_PLAN:
        return frame->payload_length == FK_PLAN_COMMAND_BYTES;
    case FK_FRAME_TABLE_BEGIN:
        return frame->payload_length == FK_TABLE_BEGIN_COMMAND_BYTES;
    case FK_FRAME_TABLE_CHUNK:
        return frame->payload_length >= FK_TABLE_CHUNK_COMMAND_BYTES;
    case FK_FRAME_TABLE_ROLLBACK:
        return frame->payload_length == FK_TABLE_ROLLBACK_COMMAND_BYTES;
    case FK_FRAME_LOG:
        return frame->payload_length == FK_LOG_COMMAND_BYTES;
    case FK_FRAME_CHALLENGE:
        return frame->payload_length == FK_CHALLENGE_COMMAND_BYTES;
    case FK_FRAME_KEY:
        return frame->payload_length == FK_KEY_COMMAND_BYTES;
    default:
        return frame->payload_length == 0u;
    }
}

int32_t fk_robot_command(fk_robot_t *robot, const fk_frame_t *frame, uint64_t now_us, uint8_t *answer)
{
    if (frame->type < FK_FRAME_HELLO || frame->type > FK_FRAME_KEY) {
        return answer_status(FK_STATUS_UNKNOWN, answer);
    }
    if (!length_fits(frame)) {
        return answer_status(FK_STATUS_LENGTH, answer);
    }
    switch (frame->type) {
    case FK_FRAME_HELLO:
        return on_hello(robot, frame, answer);
    case FK_FRAME_ARM:
        return on_arm(robot, answer);
    case FK_FRAME_DISARM:
    case FK_FRAME_STOP:
        return answer_state(robot, fk_robot_supervise(robot, frame->type), answer);
    case FK_FRAME_FIX:
        return on_fix(robot, frame->payload, now_us, answer);
    case FK_FRAME_PATH:
        return fk_robot_path_command(robot, frame->payload, frame->payload_length, answer);
    case FK_FRAME_START:
        return on_start(robot, frame->payload, now_us, answer);
    case FK_FRAME_STATUS:
        return on_status(robot, now_us, answer);
    case FK_FRAME_PARAM:
        return on_param(robot, frame->payload, answer);
    case FK_FRAME_STROKE:
        return on_stroke(robot, frame->payload, now_us, answer);
    case FK_FRAME_PLAN:
        return on_plan(robot, frame->payload, answer);
    case FK_FRAME_LOG:
        return fk_robot_log_answer(robot, frame->payload, answer);
    case FK_FRAME_CHALLENGE:
    case FK_FRAME_KEY:
        return fk_robot_key_command(robot, frame, now_us, answer);
    default:
        return fk_robot_table_command(robot, frame, now_us, answer);
    }
}
