/* What goes in and out: frames to commands, answers to the transmit buffer. */
#include "fk_robot_state.h"

/* Commands that must not act again when they are repeated. DISARM and STOP always act: two hosts may use the same
 * sequence numbers, and a robot that answered them from memory would go on. A repeated chunk or key would do no
 * harm, but its authentication counter was used before, so it is answered from memory too. */
static int32_t acts_once(uint8_t type)
{
    const int32_t changes = fk_robot_changes_state(type) || type == FK_FRAME_TABLE_CHUNK || type == FK_FRAME_KEY;
    return changes && type != FK_FRAME_DISARM && type != FK_FRAME_STOP;
}

/* Whether a frame's number counts for what is late and what is ahead: FIX has numbers of its own, HELLO asks for them, and
 * nobody but the owner moves his. */
static int32_t counts(const fk_robot_t *robot, uint8_t type, int32_t has_code)
{
    return type != FK_FRAME_FIX && type != FK_FRAME_HELLO && (has_code != 0 || !fk_robot_is_owned(robot));
}

void fk_robot_on_frame(fk_robot_t *robot, const uint8_t *encoded, uint32_t length, uint64_t now_us)
{
    fk_frame_t frame;
    /* Answers and events are no commands: on a line that echoes, the robot would answer its own answers without end, and
     * its events would pass for a host that is there. */
    if (fk_frame_decode(encoded, length, &frame) != 0 || (frame.type & (FK_ANSWER_BIT | FK_EVENT_BIT)) != 0u) {
        ++robot->frames_bad;
        return;
    }
    fk_robot_note_time(robot, now_us);
    if (robot->now_us >= robot->heard_us + FK_DUPLICATES_SILENT_US) {
        fk_duplicates_forget(&robot->duplicates);
    }
    if (!fk_robot_is_owned(robot)) {
        robot->heard_us = robot->now_us;
    }
    /* Events of an earlier tick are sent first, so that all is sent in the order in which it happened, and a host
     * can replay it. */
    fk_robot_send_events(robot);
    uint8_t *const answer = frame.payload; /* a command is read before its answer is written: less stack */
    const int32_t has_code = fk_auth_has_code(frame.type);
    const uint8_t type = (uint8_t)((has_code != 0 ? frame.type & ~FK_AUTH_BIT : frame.type) | FK_ANSWER_BIT);
    const fk_kept_answer_t *before = fk_duplicates_find(&robot->duplicates, &frame);
    if (before != 0) {
        ++robot->commands_repeated;
        fk_robot_send(robot, type, frame.sequence, before->bytes, before->length);
        return;
    }
    const int8_t refusal = fk_robot_admit(robot, &frame);
    if (refusal != FK_STATUS_OK) { /* nor is it kept for repetitions, where a stranger's frames would displace the owner's */
        fk_put_i8(answer, refusal);
        fk_robot_send(robot, type, frame.sequence, answer, 1u);
        return;
    }
    if (counts(robot, frame.type, has_code)) {
        fk_duplicates_note(&robot->duplicates, frame.sequence);
    }
    uint32_t record = 0u;
    const int32_t is_logged = fk_robot_log_command(robot, &frame, &record);
    uint32_t answer_length = (uint32_t)fk_robot_command(robot, &frame, now_us, answer);
    if (is_logged != 0) {
        fk_log_finish(robot->log, record, answer[0]);
    }
    if (acts_once(frame.type)) {
        fk_duplicates_keep(&robot->duplicates, &frame, answer, answer_length);
    }
    fk_robot_send(robot, type, frame.sequence, answer, answer_length);
}

uint32_t fk_robot_take_tx(fk_robot_t *robot, uint8_t *bytes, uint32_t capacity)
{
    fk_robot_send_events(robot);
    uint32_t count = (robot->tx_length < capacity) ? robot->tx_length : capacity;
    while (count > 0u && robot->tx[count - 1u] != 0u) { /* a delimiter */
        --count;
    }
    for (uint32_t i = 0u; i < count; ++i) {
        bytes[i] = robot->tx[i];
    }
    for (uint32_t i = count; i < robot->tx_length; ++i) {
        robot->tx[i - count] = robot->tx[i];
    }
    robot->tx_length -= count;
    return count;
}

void fk_robot_note_frames_dropped(fk_robot_t *robot, uint32_t frames) { robot->answers_dropped += frames; }
