/* The robot's state and the requested stroke. No other file changes the state or requests a stroke. */
#include "fk_robot_state.h"

void fk_robot_ask_stroke(fk_robot_t *robot, uint8_t action, uint64_t begin_us)
{
    robot->stroke_request = (uint8_t)(action + 1u);
    robot->stroke_us = begin_us;
    fk_robot_log_stroke(robot, FK_RECORD_STROKE, action);
    fk_estimator_act(&robot->estimator, begin_us, action);
}

/* The run ends and no further pulse begins; one that is on ends by itself. */
void fk_robot_no_more_pulses(fk_robot_t *robot)
{
    if (robot->stroke_request != 0u) {
        fk_robot_log_stroke(robot, FK_RECORD_DROPPED, (uint8_t)(robot->stroke_request - 1u));
        fk_estimator_act(&robot->estimator, robot->stroke_us, robot->resting_action);
    }
    robot->next_decision_us = UINT64_MAX;
    robot->second_mask = 0u;
    robot->stroke_request = 0u;
}

/* A new path that has arrived completely replaces the followed one; an incomplete one is dropped. */
void fk_robot_use_coming(fk_robot_t *robot)
{
    if (robot->coming.count != 0u) {
        for (uint32_t i = 0u; i < robot->coming.count; ++i) { /* word by word: a copied structure would become a memcpy by bytes */
            robot->path.x_m[i] = robot->coming.x_m[i];
            robot->path.y_m[i] = robot->coming.y_m[i];
            robot->path.tangent_rad[i] = robot->coming.tangent_rad[i];
        }
        robot->path.count = robot->coming.count;
        robot->path_points = robot->coming_points;
        robot->path_total = robot->coming_total;
    }
    robot->coming.count = 0u;
    robot->coming_points = 0u;
    robot->coming_total = 0u;
}

int32_t fk_is_finite_within(float value, float least, float most) { return value >= least && value <= most; }

int8_t fk_robot_may(const fk_robot_t *robot, uint8_t event) { return fk_supervisor_rule(robot->state, event).status; }

int8_t fk_robot_supervise(fk_robot_t *robot, uint8_t event)
{
    fk_rule_t rule = fk_supervisor_rule(robot->state, event);
    if (rule.action != FK_DO_NONE) {
        fk_robot_no_more_pulses(robot);
    }
    if (rule.action == FK_DO_OFF) {
        if (event == FK_EVENT_DISARM && fk_robot_is_still(robot, event)) {
            robot->off_again = 1u;
        } else {
            robot->all_off = 1u;
        }
    }
    const uint8_t before = robot->state;
    robot->state = rule.next;
    if (robot->state == FK_STATE_DISARMED || robot->state == FK_STATE_FAULT) {
        fk_auth_end(&robot->auth); /* what was sent before does not act later */
    }
    if (before == FK_STATE_RUNNING && robot->state != FK_STATE_RUNNING) {
        fk_robot_use_coming(robot); /* the next START follows the newest complete path */
    }
    if (before != robot->state) {
        fk_robot_log_state(robot, before, event);
    }
    fk_guard_closed_loop(&robot->guard, robot->state == FK_STATE_RUNNING);
    return rule.status;
}

void fk_robot_fault(fk_robot_t *robot, uint8_t fault, int32_t detail)
{
    if (robot->fault == FK_FAULT_NONE) {
        robot->fault = fault;
        robot->fault_detail = (int8_t)detail;
        fk_robot_log_fault(robot);
    }
    (void)fk_robot_supervise(robot, FK_EVENT_ERROR);
}
