#include "fk_robot.h"

#define FK_NEVER_US UINT64_MAX

uint32_t fk_robot_bytes(void) { return (uint32_t)sizeof(fk_robot_t); }

int32_t fk_robot_init(fk_robot_t *robot, const uint8_t *image, uint32_t image_bytes)
{
    int32_t error = fk_tables_open(image, image_bytes, &robot->tables);
    if (error != FK_OK) {
        return error;
    }
    error = fk_tables_check_robot(&robot->tables, FK_ROBOT_ID);
    if (error != FK_OK) {
        return error;
    }
    if (robot->tables.pulse_us > FK_PULSE_MAX_US || fk_robot_stroke_us(robot) > robot->tables.period_us) {
        return FK_ERROR_IMAGE_TIMES;
    }
    robot->plan.distance_weight_per_m = FK_DISTANCE_WEIGHT_PER_M;
    robot->plan.angle_weight_per_rad = FK_ANGLE_WEIGHT_PER_RAD;
    robot->plan.progress_weight = FK_PROGRESS_WEIGHT;
    robot->plan.level_weight = FK_LEVEL_WEIGHT;
    robot->plan.progress_weight_per_m = FK_PROGRESS_WEIGHT_PER_M;
    robot->plan.look_ahead_m = FK_LOOK_AHEAD_M;
    robot->plan.soft_distance_m = FK_SOFT_DISTANCE_M;
    robot->plan.turn_lead = FK_TURN_LEAD;
    robot->plan.transitions_max = fk_robot_transitions_within(FK_PLAN_TIME_US);
    robot->plan.cost = FK_COST;
    robot->plan.depth = FK_DEPTH;
    robot->path.count = 0u;
    fk_estimator_init(&robot->estimator, &robot->tables);
    fk_guard_init(&robot->guard);
    fk_follow_begin(&robot->follow);

    robot->state = FK_STATE_DISARMED;
    robot->path_points = 0u;
    robot->path_total = 0u;
    robot->resting_action = robot->tables.actions;
    for (uint8_t action = robot->tables.actions; action > 0u; --action) {
        fk_action_t masks;
        if (fk_tables_action(&robot->tables, (uint8_t)(action - 1u), &masks) == FK_OK && masks.first_mask == 0u &&
            masks.second_mask == 0u) {
            robot->resting_action = (uint8_t)(action - 1u);
        }
    }
    robot->period_us = robot->tables.period_us;
    robot->next_decision_us = FK_NEVER_US;
    robot->decisions = 0u;
    robot->second_mask = 0u;
    robot->second_us = 0u;
    robot->stroke_request = 0u;
    robot->stroke_us = 0u;
    robot->free_us = 0u;
    robot->all_off = 1u;
    robot->decision_pending = 0u;
    robot->refused_pending = 0u;
    robot->ended_pending = 0u;
    robot->event_sequence = 0u;
    robot->tx_length = 0u;
    robot->fixes_used = 0u;
    robot->fixes_refused = 0u;
    robot->frames_bad = 0u;
    robot->pulses = 0u;
    robot->pulses_refused = 0u;
    robot->answers_dropped = 0u;
    return FK_OK;
}

static void send(fk_robot_t *robot, uint8_t type, uint8_t sequence, const uint8_t *payload, uint32_t length)
{
    uint32_t bytes = fk_frame_encode(type, sequence, payload, length, robot->tx + robot->tx_length,
                                     FK_TX_BYTES - robot->tx_length);
    robot->tx_length += bytes;
    if (bytes == 0u) {
        ++robot->answers_dropped;
    }
}

static void send_events(fk_robot_t *robot)
{
    uint8_t payload[FK_PAYLOAD_BYTES_MAX];
    if (robot->decision_pending != 0u) {
        fk_decision_event_pack(payload, &robot->decision);
        send(robot, FK_FRAME_DECISION, robot->event_sequence, payload, FK_DECISION_EVENT_BYTES);
        ++robot->event_sequence;
        robot->decision_pending = 0u;
    }
    if (robot->refused_pending != 0u) {
        fk_refused_event_pack(payload, &robot->refused);
        send(robot, FK_FRAME_REFUSED, robot->event_sequence, payload, FK_REFUSED_EVENT_BYTES);
        ++robot->event_sequence;
        robot->refused_pending = 0u;
    }
    if (robot->ended_pending != 0u) {
        fk_ended_event_pack(payload, &robot->ended);
        send(robot, FK_FRAME_ENDED, robot->event_sequence, payload, FK_ENDED_EVENT_BYTES);
        ++robot->event_sequence;
        robot->ended_pending = 0u;
    }
}

void fk_robot_on_frame(fk_robot_t *robot, const uint8_t *encoded, uint32_t length, uint64_t now_us)
{
    fk_frame_t frame;
    /* An answer is not a command: on a line that echoes, the robot would answer its own answers for ever. */
    if (fk_frame_decode(encoded, length, &frame) != 0 || (frame.type & FK_ANSWER_BIT) != 0u) {
        ++robot->frames_bad;
        return;
    }
    /* Events of an earlier tick go first: the order of what is sent is the order of what happened, and a host
     * can decide everything again from it. */
    send_events(robot);
    uint8_t answer[FK_PAYLOAD_BYTES_MAX];
    int32_t answer_length = fk_robot_command(robot, &frame, now_us, answer);
    send(robot, (uint8_t)(frame.type | FK_ANSWER_BIT), frame.sequence, answer, (uint32_t)answer_length);
}

/* From the first pulse's start until the pulse timer is free after the second. 64 bits: a table may hold a delay
 * near 2^32 us. */
uint64_t fk_robot_stroke_us(const fk_robot_t *robot)
{
    uint64_t pulse_us = robot->tables.pulse_us;
    uint64_t delay_us = robot->tables.second_delay_us;
    uint64_t second_us = (delay_us > pulse_us) ? delay_us : pulse_us;
    return second_us + FK_STROKE_GAP_US + pulse_us + FK_STROKE_GAP_US;
}

void fk_robot_ask_stroke(fk_robot_t *robot, uint8_t action, uint64_t begin_us)
{
    robot->stroke_request = (uint8_t)(action + 1u);
    robot->stroke_us = begin_us;
    fk_estimator_act(&robot->estimator, begin_us, action);
}

/* The run ends and no further pulse begins; one that is on ends by itself. */
void fk_robot_no_more_pulses(fk_robot_t *robot)
{
    if (robot->stroke_request != 0u) {
        fk_estimator_act(&robot->estimator, robot->stroke_us, robot->resting_action);
    }
    robot->next_decision_us = FK_NEVER_US;
    robot->second_mask = 0u;
    robot->stroke_request = 0u;
}

void fk_robot_disarm(fk_robot_t *robot)
{
    robot->state = FK_STATE_DISARMED;
    fk_robot_no_more_pulses(robot);
    robot->all_off = 1u;
}

static void end_run(fk_robot_t *robot, int8_t status)
{
    if (status == FK_STATUS_STALE) {
        fk_robot_disarm(robot);
    } else {
        robot->state = FK_STATE_ARMED;
        fk_robot_no_more_pulses(robot);
    }
    robot->ended.status = status;
    robot->ended.state = robot->state;
    robot->ended.decisions = robot->decisions;
    robot->ended_pending = 1u;
}

/* Two costs are known by measurement on the chip: what a decision takes at all, and what each transition adds at
 * most. A search that may take a time may evaluate the transitions that fit into it. */
uint32_t fk_robot_transitions_within(uint32_t plan_us)
{
    if (plan_us == 0u) {
        return 0u; /* no limit */
    }
    uint32_t left_us = (plan_us > FK_PLAN_FIXED_US) ? plan_us - FK_PLAN_FIXED_US : 0u;
    uint32_t transitions = left_us * 1000u / FK_TRANSITION_NS; /* left_us <= FK_PLAN_TIME_MAX_US, so it fits */
    return (transitions > 0u) ? transitions : 1u;
}

/* A fix was taken: a run may end by it. */
void fk_robot_note_fix(fk_robot_t *robot, float x_m, float y_m)
{
    if (robot->state == FK_STATE_RUNNING) {
        int32_t status = fk_follow_fixed(&robot->follow, &robot->tables, &robot->path, &robot->plan, x_m, y_m);
        if (status != FK_FOLLOW_ON) {
            end_run(robot, (int8_t)status);
        }
    }
}

static int32_t fix_is_lost(const fk_robot_t *robot, uint64_t at_us)
{
    return fk_estimator_is_lost(&robot->estimator, at_us, FK_FIX_LOST_US);
}

static void put_state(const fk_state_t *state, float *x_m, float *y_m, float *heading_rad, float *vx_mps,
                      float *vy_mps, float *omega_rad_s)
{
    *x_m = state->x_m;
    *y_m = state->y_m;
    *heading_rad = state->heading_rad;
    *vx_mps = state->vx_mps;
    *vy_mps = state->vy_mps;
    *omega_rad_s = state->omega_rad_s;
}

/* One decision: estimate, plan, report, ask for the stroke; without an estimate the resting one. */
static void decide(fk_robot_t *robot)
{
    static const fk_state_t nowhere = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, {0u}, 0.0f};
    fk_decision_event_t *event = &robot->decision;
    fk_estimate_t estimate = {nowhere, 0u, 0u};
    fk_plan_t plan = {robot->resting_action, 0u, 0u, 0u, 0u, 0.0f, 0.0f, robot->follow.along_points, nowhere};
    int32_t end = FK_FOLLOW_ON;

    int32_t status = fk_estimator_at(&robot->estimator, robot->next_decision_us, &estimate);
    if (status == FK_STATUS_OK) {
        estimate.state.along_points = robot->follow.along_points;
        status = fk_plan(&robot->tables, &robot->path, &robot->plan, &estimate.state, &plan);
    }
    if (status == FK_STATUS_OK) {
        end = fk_follow_decided(&robot->follow, &robot->tables, &robot->path, &robot->plan, &plan);
    } else {
        plan.action = robot->resting_action;
    }
    event->status = (int8_t)status;
    event->action = plan.action;
    event->decision = robot->decisions;
    event->scheduled_us = robot->next_decision_us;
    event->fix_sequence = estimate.fix_sequence;
    event->fixes_in_estimate = estimate.fixes;
    event->path_index = plan.path_index;
    event->nearest_state = plan.nearest_state;
    event->plan_us = 0u;
    event->depth_reached = plan.depth_reached;
    event->transitions = plan.transitions;
    event->cost = plan.cost;
    event->distance_m = plan.distance_m;
    event->along_points = plan.along_points;
    put_state(&estimate.state, &event->x_m, &event->y_m, &event->heading_rad, &event->vx_mps, &event->vy_mps,
              &event->omega_rad_s);
    put_state(&plan.predicted, &event->predicted_x_m, &event->predicted_y_m, &event->predicted_heading_rad,
              &event->predicted_vx_mps, &event->predicted_vy_mps, &event->predicted_omega_rad_s);
    event->limb_use_0 = estimate.state.limb_use[0];
    event->limb_use_1 = estimate.state.limb_use[1];
    event->limb_use_2 = estimate.state.limb_use[2];
    event->limb_use_3 = estimate.state.limb_use[3];
    event->limb_use_4 = estimate.state.limb_use[4];
    event->limb_use_5 = estimate.state.limb_use[5];
    event->limb_use_6 = estimate.state.limb_use[6];
    event->limb_use_7 = estimate.state.limb_use[7];
    robot->decision_pending = 1u;
    ++robot->decisions;
    if (end != FK_FOLLOW_ON) {
        end_run(robot, (int8_t)end);
        return;
    }
    fk_robot_ask_stroke(robot, plan.action, robot->next_decision_us);
    robot->next_decision_us += robot->period_us;
}

static int32_t fire(fk_robot_t *robot, uint8_t limb_mask, uint64_t now_us, fk_outputs_t *outputs)
{
    if (fk_guard_allow(&robot->guard, limb_mask, robot->tables.pulse_us, now_us)) {
        outputs->limb_mask = limb_mask;
        outputs->pulse_us = robot->tables.pulse_us;
        robot->free_us = now_us + robot->tables.pulse_us + FK_STROKE_GAP_US;
        ++robot->pulses;
        return 1;
    }
    ++robot->pulses_refused;
    return 0;
}

static void begin_stroke(fk_robot_t *robot, uint8_t action, uint64_t now_us, fk_outputs_t *outputs)
{
    fk_action_t masks;
    if (fk_tables_action(&robot->tables, action, &masks) != FK_OK) {
        return; /* a table without a resting action, and no estimate: nothing fires */
    }
    if (masks.first_mask != 0u && !fire(robot, masks.first_mask, now_us, outputs)) {
        /* Half a stroke is none of the table's motions: none of it begins, and host and estimator are told so. */
        fk_estimator_act(&robot->estimator, robot->stroke_us, robot->resting_action);
        robot->refused.action = action;
        robot->refused.begin_us = robot->stroke_us;
        robot->refused_pending = 1u;
        return;
    }
    robot->second_mask = masks.second_mask;
    robot->second_us = now_us + robot->tables.second_delay_us + FK_STROKE_GAP_US;
}

static uint64_t later(uint64_t a_us, uint64_t b_us) { return (a_us > b_us) ? a_us : b_us; }

void fk_robot_tick(fk_robot_t *robot, uint64_t now_us, fk_outputs_t *outputs)
{
    outputs->limb_mask = 0u;
    outputs->pulse_us = 0u;
    outputs->all_off = robot->all_off;
    if (robot->all_off != 0u) {
        fk_guard_cut(&robot->guard, now_us);
        robot->free_us = now_us;
        robot->all_off = 0u;
    }

    if (robot->second_mask != 0u) {
        if (now_us >= later(robot->second_us, robot->free_us)) {
            (void)fire(robot, robot->second_mask, now_us, outputs);
            robot->second_mask = 0u;
        }
    } else if (robot->stroke_request != 0u) {
        if (now_us >= robot->free_us) {
            begin_stroke(robot, (uint8_t)(robot->stroke_request - 1u), now_us, outputs);
            robot->stroke_request = 0u;
        }
    } else if (robot->state == FK_STATE_RUNNING && now_us >= robot->next_decision_us) {
        /* What the port has not taken yet goes into the buffer, where a decision that does not fit is counted. */
        send_events(robot);
        if (fix_is_lost(robot, robot->next_decision_us)) {
            end_run(robot, FK_STATUS_STALE);
        } else {
            decide(robot);
        }
    }

    /* A decision waits for a stroke that is under way; it is for its own time whenever it is made. */
    if (robot->all_off != 0u) {
        outputs->next_tick_us = now_us;
    } else if (robot->second_mask != 0u) {
        outputs->next_tick_us = later(robot->second_us, robot->free_us);
    } else if (robot->stroke_request != 0u) {
        outputs->next_tick_us = later(now_us, robot->free_us);
    } else {
        outputs->next_tick_us = robot->next_decision_us;
    }
}

void fk_robot_note_tick(fk_robot_t *robot, uint32_t elapsed_us)
{
    if (robot->decision_pending != 0u && robot->decision.plan_us == 0u) {
        robot->decision.plan_us = elapsed_us;
    }
}

uint32_t fk_robot_take_tx(fk_robot_t *robot, uint8_t *bytes, uint32_t capacity)
{
    send_events(robot);
    uint32_t count = (robot->tx_length < capacity) ? robot->tx_length : capacity;
    for (uint32_t i = 0u; i < count; ++i) {
        bytes[i] = robot->tx[i];
    }
    for (uint32_t i = count; i < robot->tx_length; ++i) {
        robot->tx[i - count] = robot->tx[i];
    }
    robot->tx_length -= count;
    return count;
}
