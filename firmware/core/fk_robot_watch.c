/* What ends a run or disarms the robot without a command: a clock that goes back, lost fixes, a silent host, a low
 * supply. */
#include "fk_robot_state.h"

void fk_robot_end_run(fk_robot_t *robot, int8_t status, uint8_t event)
{
    (void)fk_robot_supervise(robot, event);
    robot->ended.status = status;
    robot->ended.state = robot->state;
    robot->ended.decisions = robot->decisions;
    robot->ended_pending = 1u;
    uint8_t content[FK_ENDED_EVENT_BYTES];
    fk_ended_event_pack(content, &robot->ended);
    fk_robot_log(robot, FK_RECORD_ENDED, content, FK_ENDED_EVENT_BYTES);
}

void fk_robot_note_supply(fk_robot_t *robot, int32_t is_low)
{
    const uint8_t before = robot->supply;
    if (is_low == 0) {
        robot->supply = (before == FK_SUPPLY_LOW) ? (uint8_t)FK_SUPPLY_FELL : before;
    } else {
        robot->supply = FK_SUPPLY_LOW;
        if (robot->state == FK_STATE_RUNNING) {
            fk_robot_end_run(robot, FK_STATUS_SUPPLY, FK_EVENT_SUPPLY_LOW);
        } else if (robot->state == FK_STATE_ARMED) {
            (void)fk_robot_supervise(robot, FK_EVENT_SUPPLY_LOW);
        }
    }
    if (robot->supply != before) {
        robot->log_broken = 1u; /* whether ARM is refused depends on it */
    }
}

void fk_robot_note_clock_failed(fk_robot_t *robot)
{
    if (robot->state != FK_STATE_FAULT) {
        fk_robot_fault(robot, FK_FAULT_CLOCK, 0);
    }
}

void fk_robot_note_link_lost(fk_robot_t *robot) { (void)fk_robot_supervise(robot, FK_EVENT_LINK_LOST); }

/* A robot must not stay armed when nobody talks to it. In a run, lost fixes end it sooner. */
static int32_t is_host_silent(const fk_robot_t *robot)
{
    return robot->state == FK_STATE_ARMED && robot->replays == 0u &&
           robot->now_us >= robot->heard_us + FK_LINK_SILENT_US;
}

/* Checks before every frame and every tick. */
void fk_robot_note_time(fk_robot_t *robot, uint64_t now_us)
{
    if (now_us < robot->now_us) {
        fk_robot_fault(robot, FK_FAULT_TIME, 0);
        return;
    }
    robot->now_us = now_us;
    if (robot->state >= FK_STATES) {
        fk_robot_fault(robot, FK_FAULT_STATE, 0);
    }
    if (robot->state == FK_STATE_RUNNING && now_us >= fk_guard_lost_us(&robot->guard)) {
        fk_robot_end_run(robot, FK_STATUS_STALE, FK_EVENT_FIX_LOST);
    }
    if (is_host_silent(robot)) {
        fk_robot_note_link_lost(robot);
    }
}
