/* What goes into the robot's log, and when: enough to replay every decision from any snapshot on.
 *
 * Commands that change something are logged with the status of their answer, and everything that the robot does by
 * itself. Fixes that arrive while it is disarmed are not logged, nor what a robot in FAULT refuses: a camera that
 * runs on for minutes would overwrite the run before. The next ARM then begins with a snapshot. Nor is DISARM or STOP
 * logged where the robot has an owner and it changes nothing.
 */
#include "fk_robot_state.h"
#include "fk_store.h"

/* Commands that change something, other than FIX: the estimator has its own filter for duplicate fixes. */
int32_t fk_robot_changes_state(uint8_t type)
{
    return type == FK_FRAME_ARM || type == FK_FRAME_DISARM || type == FK_FRAME_PATH || type == FK_FRAME_START ||
           type == FK_FRAME_STOP || type == FK_FRAME_PARAM || type == FK_FRAME_STROKE || type == FK_FRAME_TABLE_BEGIN ||
           type == FK_FRAME_TABLE_COMMIT || type == FK_FRAME_TABLE_ROLLBACK;
}

/* A robot that replays a log has no store, so no owner: the commands in a log had been admitted. */
int32_t fk_robot_is_owned(const fk_robot_t *robot) { return robot->store != 0 && fk_store_is_owned(robot->store); }

/* Whether DISARM or STOP changes nothing. Of a robot that has an owner such a command is not logged: anybody may send it
 * on and on, and would push the owner's records out of the log. */
int32_t fk_robot_is_still(const fk_robot_t *robot, uint8_t event)
{
    if (!fk_robot_is_owned(robot) || robot->all_off != 0u) {
        return 0;
    }
    return robot->state == FK_STATE_DISARMED || robot->state == FK_STATE_FAULT ||
           (event == FK_EVENT_STOP && robot->state == FK_STATE_ARMED && robot->stroke_request == 0u &&
            robot->second_mask == 0u);
}

uint32_t fk_robot_rest_us(const fk_robot_t *robot)
{
    const uint64_t until_us = (robot->heat_unknown != 0u) ? FK_UNKNOWN_HEAT_REST_US : 0u;
    return (robot->now_us < until_us) ? (uint32_t)(until_us - robot->now_us) : 0u;
}

void fk_robot_use_log(fk_robot_t *robot, fk_log_t *log)
{
    fk_boot_record_t boot;
    uint8_t content[FK_BOOT_RECORD_BYTES];
    boot.continued = (uint8_t)fk_log_open(log);
    boot.reset = robot->reset;
    boot.table_crc = robot->tables.image_crc32;
    boot.rest_us = fk_robot_rest_us(robot);
    robot->log = log;
    robot->log_mark = log->end;
    robot->log_broken = 1u;
    fk_boot_record_pack(content, &boot);
    fk_robot_log(robot, FK_RECORD_BOOT, content, FK_BOOT_RECORD_BYTES);
    if (robot->fault != FK_FAULT_NONE) {
        fk_robot_log_fault(robot);
    }
}

void fk_robot_log(fk_robot_t *robot, uint8_t id, const uint8_t *content, uint32_t length)
{
    if (robot->log != 0) {
        (void)fk_log_write(robot->log, id, robot->now_us, content, length);
    }
}

void fk_robot_log_fault(fk_robot_t *robot)
{
    fk_fault_record_t record = {robot->fault, robot->fault_detail};
    uint8_t content[FK_FAULT_RECORD_BYTES];
    fk_fault_record_pack(content, &record);
    fk_robot_log(robot, FK_RECORD_FAULT, content, FK_FAULT_RECORD_BYTES);
}

void fk_robot_log_state(fk_robot_t *robot, uint8_t before, uint8_t event)
{
    fk_state_record_t record = {before, robot->state, event};
    uint8_t content[FK_STATE_RECORD_BYTES];
    fk_state_record_pack(content, &record);
    fk_robot_log(robot, FK_RECORD_STATE, content, FK_STATE_RECORD_BYTES);
}

void fk_robot_log_stroke(fk_robot_t *robot, uint8_t id, uint8_t action)
{
    fk_stroke_record_t record = {action, robot->stroke_us}; /* all records of strokes have the same content */
    uint8_t content[FK_STROKE_RECORD_BYTES];
    fk_stroke_record_pack(content, &record);
    fk_robot_log(robot, id, content, FK_STROKE_RECORD_BYTES);
}

void fk_robot_log_pulse(fk_robot_t *robot, uint8_t limb_mask, uint8_t allowed)
{
    fk_pulse_record_t record = {limb_mask, allowed, robot->tables.pulse_us};
    uint8_t content[FK_PULSE_RECORD_BYTES];
    fk_pulse_record_pack(content, &record);
    fk_robot_log(robot, FK_RECORD_PULSE, content, FK_PULSE_RECORD_BYTES);
}

static int32_t is_of_tables(uint8_t type)
{
    return type == FK_FRAME_TABLE_BEGIN || type == FK_FRAME_TABLE_COMMIT || type == FK_FRAME_TABLE_ROLLBACK;
}

/* A replay begins at a snapshot. One is written before ARM if something was not logged since the last, and after
 * every FK_LOG_SNAPSHOT_EVERY_BYTES, so that the ring holds one (fk_log.h). While an update of the table is open ARM
 * is refused. */
static int32_t wants_snapshot(const fk_robot_t *robot, uint8_t type)
{
    if (robot->state == FK_STATE_DISARMED &&
        (type != FK_FRAME_ARM || (robot->store != 0 && robot->store->open != 0u))) {
        return 0;
    }
    if (robot->log_broken != 0u) {
        return 1;
    }
    /* It takes about 2 ms on the chip, so not while a pulse is due. */
    return robot->log->end - robot->log_mark >= FK_LOG_SNAPSHOT_EVERY_BYTES && robot->stroke_request == 0u &&
           robot->second_mask == 0u;
}

/* Returns 1 where the command is logged, with its record's offset; else 0. */
int32_t fk_robot_log_command(fk_robot_t *robot, const fk_frame_t *frame, uint32_t *record)
{
    uint8_t content[FK_COMMAND_RECORD_BYTES + FK_PAYLOAD_BYTES_MAX + 1u];
    const int32_t is_fix = frame->type == FK_FRAME_FIX;
    if (robot->log == 0 || robot->state == FK_STATE_FAULT || (!is_fix && !fk_robot_changes_state(frame->type))) {
        return 0;
    }
    if ((frame->type == FK_FRAME_DISARM || frame->type == FK_FRAME_STOP) && fk_robot_is_still(robot, frame->type)) {
        return 0;
    }
    if (is_fix && robot->state == FK_STATE_DISARMED) {
        robot->log_broken = 1u;
        return 0;
    }
    if (wants_snapshot(robot, frame->type)) {
        fk_robot_log_snapshot(robot);
        robot->log_broken = 0u;
        robot->log_mark = robot->log->end;
    }
    if (is_of_tables(frame->type)) {
        robot->log_broken = 1u;
    }
    fk_command_record_t command = {frame->type};
    fk_command_record_pack(content, &command);
    for (uint32_t i = 0u; i < frame->payload_length; ++i) {
        content[FK_COMMAND_RECORD_BYTES + i] = frame->payload[i];
    }
    uint32_t length = FK_COMMAND_RECORD_BYTES + frame->payload_length;
    fk_put_i8(content + length, FK_LOG_UNFINISHED);
    *record = fk_log_write(robot->log, FK_RECORD_COMMAND, robot->now_us, content, length + 1u);
    return 1;
}

int32_t fk_robot_log_answer(const fk_robot_t *robot, const uint8_t *payload, uint8_t *answer)
{
    if (robot->log == 0) { /* a port without one */
        fk_put_i8(answer, FK_STATUS_UNKNOWN);
        return 1;
    }
    fk_log_command_t command;
    fk_log_command_unpack(payload, &command);
    fk_log_answer_t reply = {FK_STATUS_OK, 0u, robot->log->begin, robot->log->end, robot->log->lost};
    uint32_t count = fk_log_read(robot->log, command.offset, answer + FK_LOG_ANSWER_BYTES, FK_LOG_ANSWER_ROWS_MAX,
                                 &reply.offset);
    fk_log_answer_pack(answer, &reply);
    return (int32_t)(FK_LOG_ANSWER_BYTES + count);
}
