#include "fk_robot_state.h"

/* What depends on the table. */
static void begin_with_tables(fk_robot_t *robot, uint8_t learn)
{
    fk_estimator_init(&robot->estimator, &robot->tables, learn);
    robot->period_us = robot->tables.period_us;
    robot->transitions_most = fk_fit_transitions(&robot->tables);
    robot->resting_action = robot->tables.actions;
    for (uint8_t action = robot->tables.actions; action > 0u; --action) {
        fk_action_t masks;
        if (fk_tables_action(&robot->tables, (uint8_t)(action - 1u), &masks) == FK_OK && masks.first_mask == 0u &&
            masks.second_mask == 0u) {
            robot->resting_action = (uint8_t)(action - 1u);
        }
    }
}

/* Without tables it answers all the same, in FAULT. */
static int32_t open_tables(fk_robot_t *robot, const uint8_t *image, uint32_t image_bytes, uint8_t learn)
{
    int32_t error = fk_fit_open(image, image_bytes, &robot->tables);
    if (error != FK_OK) {
        static const fk_tables_t none;
        static const char robot_id[] = FK_ROBOT_ID;
        robot->tables = none;
        for (uint32_t i = 0u; i + 1u < sizeof(robot_id); ++i) {
            robot->tables.robot_id[i] = robot_id[i];
        }
        robot->estimator.restarts = 0u;
        fk_wear_init(&robot->estimator.track.wear, &robot->tables, FK_LEARN_OFF);
        robot->period_us = 0u;
        fk_robot_fault(robot, FK_FAULT_TABLE, error);
        return error;
    }
    begin_with_tables(robot, learn);
    return FK_OK;
}

int32_t fk_robot_init(fk_robot_t *robot, const uint8_t *image, uint32_t image_bytes)
{
#define DEFAULT(name, NAME, least, most) robot->plan.name = FK_##NAME;
    FK_PLAN_WEIGHTS(DEFAULT)
    robot->plan.transitions_max = fk_robot_transitions_within(FK_PLAN_TIME_US);
    robot->plan.cost = FK_COST;
    robot->plan.depth = FK_DEPTH;
    robot->path.count = 0u;
    fk_guard_init(&robot->guard);
    fk_duplicates_init(&robot->duplicates);
    fk_auth_init(&robot->auth);
    fk_follow_begin(&robot->follow);

    robot->state = FK_STATE_DISARMED;
    robot->fault = FK_FAULT_NONE;
    robot->fault_detail = 0;
    robot->reset = FK_RESET_UNKNOWN;
    robot->heat_unknown = 1u;
    robot->supply = FK_SUPPLY_OK;
    robot->persistent = 0;
    robot->learned = 0;
    robot->store = 0;
    robot->log = 0;
    robot->log_mark = 0u;
    robot->log_broken = 1u;
    robot->now_us = 0u;
    robot->heard_us = 0u;
    robot->replays = 0u;
    robot->fired_mask = 0u;
    robot->fired_first = 0u;
    robot->coming.count = 0u;
    robot->coming_points = 0u;
    robot->coming_total = 0u;
    robot->path_points = 0u;
    robot->path_total = 0u;
    robot->next_decision_us = UINT64_MAX;
    robot->decisions = 0u;
    robot->second_mask = 0u;
    robot->second_us = 0u;
    robot->stroke_request = 0u;
    robot->stroke_us = 0u;
    robot->free_us = 0u;
    robot->all_off = 1u;
    robot->off_again = 0u;
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
    robot->commands_repeated = 0u;

    return open_tables(robot, image, image_bytes, FK_LEARN_OFF);
}

void fk_robot_note_reset(fk_robot_t *robot, uint8_t reset, fk_guard_persistent_t *persistent)
{
    robot->reset = reset;
    robot->persistent = persistent;
    /* Of unknown heat nothing is kept until the first pulse, which is allowed when the limbs have rested: a reset before
     * that begins their rest again. */
    robot->heat_unknown = (fk_guard_resume(&robot->guard, persistent) == 0) ? 1u : 0u;
}

void fk_robot_use_learned(fk_robot_t *robot, fk_wear_persistent_t *learned)
{
    robot->learned = learned;
    (void)fk_wear_resume(&robot->estimator.track.wear, &robot->tables, learned);
}

void fk_robot_use_store(fk_robot_t *robot, fk_store_t *store)
{
    robot->store = store;
    if (store->lost != 0u) {
        fk_robot_fault(robot, FK_FAULT_STORE, 0);
    }
}

/* The store has put another table in use, and checked it; the robot is disarmed. Where the flash no longer holds what was
 * checked the robot is in FAULT. The guard's history stays as it is. */
void fk_robot_use_tables(fk_robot_t *robot)
{
    const uint32_t restarts = robot->estimator.restarts; /* STATUS counts since boot */
    (void)open_tables(robot, robot->store->image, robot->store->image_bytes, robot->estimator.track.wear.learn);
    robot->estimator.restarts = restarts;
}

/* Two durations were measured on the chip: the fixed part of a decision, and the most that each transition adds. A
 * search of limited time may evaluate as many transitions as fit into the rest of it. */
uint32_t fk_robot_transitions_within(uint32_t plan_us)
{
    if (plan_us == 0u || plan_us > FK_PLAN_TIME_WATCHDOG_US) {
        plan_us = FK_PLAN_TIME_WATCHDOG_US; /* also without a limit: the watchdog would end a longer search */
    }
    uint32_t left_us = (plan_us > FK_PLAN_FIXED_US) ? plan_us - FK_PLAN_FIXED_US : 0u;
    uint32_t transitions = left_us * 1000u / FK_TRANSITION_NS; /* left_us < FK_PLAN_TIME_WATCHDOG_US, so it fits */
    return (transitions > 0u) ? transitions : 1u;
}

int32_t fk_robot_plan(const fk_robot_t *robot, uint8_t depth, const fk_state_t *state, fk_plan_t *plan)
{
    const uint32_t most = robot->transitions_most;
    fk_plan_config_t config = robot->plan;
    config.depth = depth;
    config.transitions_max = (config.transitions_max > most) ? most : config.transitions_max; /* it is never 0: no limit */
    return fk_plan(&robot->tables, &robot->path, &config, state, plan);
}

/* The estimator took a fix, which may end the run; not while a new path waits, which the next decision will
 * follow. */
void fk_robot_note_fix(fk_robot_t *robot, uint64_t capture_us, float x_m, float y_m)
{
    fk_guard_note_fix(&robot->guard, capture_us);
    if (robot->state == FK_STATE_RUNNING && robot->coming.count == 0u) {
        int32_t status = fk_follow_fixed(&robot->follow, &robot->tables, &robot->path, &robot->plan, x_m, y_m);
        if (status != FK_FOLLOW_ON) {
            fk_robot_end_run(robot, (int8_t)status, FK_EVENT_RUN_OVER);
        }
    }
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
        fk_track_end_period(&robot->estimator.track, robot->next_decision_us);
        if (robot->coming.count != 0u) {
            fk_robot_use_coming(robot);
            fk_follow_change(&robot->follow, &robot->tables, &robot->path, estimate.state.x_m, estimate.state.y_m);
            plan.along_points = robot->follow.along_points;
        }
        estimate.state.along_points = robot->follow.along_points;
        status = fk_robot_plan(robot, robot->plan.depth, &estimate.state, &plan);
    }
    if (status == FK_STATUS_OK) {
        end = fk_follow_decided(&robot->follow, &robot->tables, &robot->path, &robot->plan, &plan,
                                fk_wear_lacks_a_limb(&robot->estimator.track.wear));
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
    event->lost_0 = robot->estimator.track.wear.lost[0];
    event->lost_1 = robot->estimator.track.wear.lost[1];
    event->lost_2 = robot->estimator.track.wear.lost[2];
    event->lost_3 = robot->estimator.track.wear.lost[3];
    event->lost_4 = robot->estimator.track.wear.lost[4];
    event->lost_5 = robot->estimator.track.wear.lost[5];
    event->lost_6 = robot->estimator.track.wear.lost[6];
    event->lost_7 = robot->estimator.track.wear.lost[7];
    robot->decision_pending = 1u;
    ++robot->decisions;
    uint8_t content[FK_DECISION_EVENT_BYTES];
    fk_decision_event_pack(content, event);
    fk_robot_log(robot, FK_RECORD_DECISION, content, FK_DECISION_EVENT_BYTES);
    if (end != FK_FOLLOW_ON) {
        fk_robot_end_run(robot, (int8_t)end, FK_EVENT_RUN_OVER);
        return;
    }
    fk_robot_ask_stroke(robot, plan.action, robot->next_decision_us);
    robot->next_decision_us += robot->period_us;
}

/* Write the guard's history to persistent RAM. Of a damaged one nothing is kept: the limbs' heat is unknown at the
 * next start. */
static void keep_history(fk_robot_t *robot, int32_t is_sound)
{
    if (robot->persistent != 0) {
        if (is_sound != 0) {
            fk_guard_keep(&robot->guard, robot->persistent);
        } else {
            fk_guard_invalidate(robot->persistent);
        }
    }
}

/* At each tick: fixes, decisions and commands change the estimate of wear, and a tick follows each of them. */
static void keep_learned(fk_robot_t *robot)
{
    if (robot->learned != 0) {
        fk_wear_keep(&robot->estimator.track.wear, &robot->tables, robot->learned);
    }
}

static int32_t fire(fk_robot_t *robot, uint8_t limb_mask, uint64_t now_us, fk_outputs_t *outputs)
{
    int32_t allowed = 0;
    if (fk_robot_may(robot, FK_EVENT_PULSE) == FK_STATUS_OK) {
        allowed = fk_guard_allow(&robot->guard, limb_mask, robot->tables.pulse_us, now_us);
    }
    if (allowed > 0) {
        keep_history(robot, 1);
        outputs->limb_mask = limb_mask;
        outputs->pulse_us = robot->tables.pulse_us;
        robot->free_us = now_us + robot->tables.pulse_us + FK_STROKE_GAP_US;
        ++robot->pulses;
        robot->fired_mask = limb_mask;
        robot->fired_first = 0u;
        fk_robot_log_pulse(robot, limb_mask, FK_PULSE_ASKED);
        return 1;
    }
    if (allowed < 0) {
        keep_history(robot, 0);
        fk_robot_fault(robot, FK_FAULT_GUARD, 0);
    }
    ++robot->pulses_refused;
    fk_robot_log_pulse(robot, limb_mask, FK_PULSE_REFUSED);
    return 0;
}

/* The table has no motion for half a stroke, so none of it begins; the estimator and the host learn that it is
 * refused. Second limbs are not asked for before the first ones have fired: their refusal is only counted and logged. */
static void refuse_stroke(fk_robot_t *robot, uint8_t action)
{
    fk_estimator_act(&robot->estimator, robot->stroke_us, robot->resting_action);
    robot->refused.action = action;
    robot->refused.begin_us = robot->stroke_us;
    robot->refused_pending = 1u;
    robot->second_mask = 0u;
    fk_robot_log_stroke(robot, FK_RECORD_REFUSED, action);
}

void fk_robot_note_pulse_failed(fk_robot_t *robot, int32_t error)
{
    if (error != FK_PULSE_LATE || robot->fired_mask == 0u) {
        fk_robot_fault(robot, FK_FAULT_PULSE, error);
        return;
    }
    if (!fk_guard_is_sound(&robot->guard)) {
        keep_history(robot, 0);
        fk_robot_fault(robot, FK_FAULT_GUARD, 0);
        return;
    }
    fk_guard_not_begun(&robot->guard, robot->fired_mask);
    keep_history(robot, 1);
    --robot->pulses;
    ++robot->pulses_refused;
    fk_robot_log_pulse(robot, robot->fired_mask, FK_PULSE_TOO_LATE);
    if (robot->fired_first != 0u) {
        refuse_stroke(robot, (uint8_t)(robot->fired_first - 1u));
    }
    robot->fired_mask = 0u;
}

static void begin_stroke(fk_robot_t *robot, uint8_t action, uint64_t now_us, fk_outputs_t *outputs)
{
    fk_action_t masks;
    fk_robot_log_stroke(robot, FK_RECORD_BEGUN, action);
    if (action == robot->tables.actions) {
        return; /* no estimate, and the table has no resting action: nothing fires */
    }
    if (fk_tables_action(&robot->tables, action, &masks) != FK_OK) {
        fk_robot_fault(robot, FK_FAULT_ACTION, 0);
        return;
    }
    if (masks.first_mask != 0u && !fire(robot, masks.first_mask, now_us, outputs)) {
        refuse_stroke(robot, action);
        return;
    }
    robot->fired_first = (uint8_t)((masks.first_mask != 0u) ? action + 1u : 0u);
    robot->second_mask = masks.second_mask;
    robot->second_us = now_us + robot->tables.second_delay_us + FK_STROKE_GAP_US;
}

static uint64_t later(uint64_t a_us, uint64_t b_us) { return (a_us > b_us) ? a_us : b_us; }

void fk_robot_tick(fk_robot_t *robot, uint64_t now_us, fk_outputs_t *outputs)
{
    outputs->limb_mask = 0u;
    outputs->pulse_us = 0u;
    robot->fired_mask = 0u;
    fk_robot_note_time(robot, now_us);
    outputs->all_off = (robot->all_off != 0u || robot->off_again != 0u) ? 1u : 0u;
    robot->off_again = 0u;
    if (robot->all_off != 0u) {
        fk_robot_log(robot, FK_RECORD_OFF, 0, 0u);
        fk_guard_cut(&robot->guard, now_us);
        robot->free_us = now_us;
        robot->all_off = 0u;
    }

    if (robot->second_mask != 0u) {
        if (now_us >= later(robot->second_us, robot->free_us)) {
            const uint8_t alone = robot->stroke_request; /* 1 + action of a stroke that has no first limbs; else 0 */
            if (!fire(robot, robot->second_mask, now_us, outputs) && alone != 0u) {
                refuse_stroke(robot, (uint8_t)(alone - 1u));
            }
            robot->fired_first = alone;
            robot->stroke_request = 0u;
            robot->second_mask = 0u;
        }
    } else if (robot->stroke_request != 0u) {
        if (now_us >= robot->free_us) {
            begin_stroke(robot, (uint8_t)(robot->stroke_request - 1u), now_us, outputs);
            if (robot->second_mask == 0u || robot->fired_first != 0u) {
                robot->stroke_request = 0u;
            } /* else the stroke has no first limbs, and begins when its second ones fire */
        }
    } else if (robot->state == FK_STATE_RUNNING && now_us >= robot->next_decision_us && outputs->all_off == 0u) {
        /* Not in a tick that switches limbs off, which must not wait for it. Events that wait go into the transmit
         * buffer first, which counts those that do not fit. */
        fk_robot_send_events(robot);
        decide(robot);
    }

    keep_learned(robot);

    /* A decision waits for the current stroke to have begun. It is computed for its scheduled time, however late
     * it is made. */
    if (robot->all_off != 0u) {
        outputs->next_tick_us = now_us;
    } else if (robot->second_mask != 0u) {
        outputs->next_tick_us = later(robot->second_us, robot->free_us);
    } else if (robot->stroke_request != 0u) {
        outputs->next_tick_us = later(now_us, robot->free_us);
    } else {
        outputs->next_tick_us = robot->next_decision_us;
    }
    uint64_t lost_us = UINT64_MAX;
    if (robot->state == FK_STATE_RUNNING) {
        lost_us = fk_guard_lost_us(&robot->guard);
    } else if (robot->state == FK_STATE_ARMED) {
        lost_us = robot->heard_us + FK_LINK_SILENT_US;
    }
    outputs->next_tick_us = (lost_us < outputs->next_tick_us) ? lost_us : outputs->next_tick_us;
}

void fk_robot_note_tick(fk_robot_t *robot, uint32_t elapsed_us)
{
    if (robot->decision_pending != 0u && robot->decision.plan_us == 0u) {
        robot->decision.plan_us = elapsed_us;
    }
}
