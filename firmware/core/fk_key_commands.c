/* The commands of the owner's key, and who may give which command. */
#include "fk_robot_state.h"
#include "fk_store.h"

/* Check and remove a frame's code, or refuse the frame. Only the owner's frames keep an armed robot from disarming, and a
 * conversation from ending: a command that somebody held back is worth nothing when its owner has left. */
int8_t fk_robot_admit(fk_robot_t *robot, fk_frame_t *frame)
{
    const int32_t is_owned = fk_robot_is_owned(robot);
    if (!fk_auth_has_code(frame->type)) {
        return (is_owned && fk_frame_needs_code(frame->type)) ? (int8_t)FK_STATUS_AUTH : (int8_t)FK_STATUS_OK;
    }
    if (robot->now_us >= robot->heard_us + FK_LINK_SILENT_US) {
        robot->auth.has_current = 0u;
    }
    if (!is_owned || fk_auth_check(&robot->auth, frame, robot->now_us) != FK_STATUS_OK) {
        return FK_STATUS_MAC;
    }
    robot->heard_us = robot->now_us;
    return FK_STATUS_OK;
}

static int8_t take_key(fk_robot_t *robot, const uint8_t *payload, uint64_t now_us)
{
    fk_key_command_t command;
    fk_key_command_unpack(payload, &command);
    const uint32_t key[FK_STORE_KEY_WORDS] = {command.key_0, command.key_1, command.key_2, command.key_3,
                                              command.key_4, command.key_5, command.key_6, command.key_7};
    int8_t status = fk_robot_may(robot, FK_EVENT_KEY);
    if (status != FK_STATUS_OK) {
        return status;
    }
    if (robot->store->open != 0u || !fk_robot_is_at_rest(robot, now_us)) {
        return FK_STATUS_STATE;
    }
    if (!fk_auth_seed(&robot->auth)) {
        return FK_STATUS_UNKNOWN; /* with a key but no nonces, nobody could command the robot any more */
    }
    status = fk_store_own(robot->store, key);
    fk_auth_end(&robot->auth);
    return status;
}

static int32_t on_challenge(fk_robot_t *robot, const uint8_t *payload, uint64_t now_us, uint8_t *answer)
{
    const uint8_t *nonce = robot->auth.nonce;
    uint8_t proof[FK_AUTH_PROOF_BYTES];
    int8_t status = fk_robot_may(robot, FK_EVENT_CHALLENGE);
    if (status == FK_STATUS_OK && !fk_robot_is_owned(robot)) {
        status = FK_STATUS_AUTH;
    }
    if (status == FK_STATUS_OK && robot->store->lost != 0u) {
        status = FK_STATUS_FAULT; /* the key that is left may be one that was taken away */
    }
    if (status == FK_STATUS_OK &&
        fk_auth_answer(&robot->auth, robot->store->record.owner_key, payload, now_us, proof) != 0) {
        status = FK_STATUS_UNKNOWN;
    }
    if (status != FK_STATUS_OK) {
        fk_put_i8(answer, status);
        return 1;
    }
    fk_challenge_answer_t reply = {status,
                                  fk_get_u32(nonce), fk_get_u32(nonce + 4), fk_get_u32(nonce + 8), fk_get_u32(nonce + 12),
                                  fk_get_u32(proof), fk_get_u32(proof + 4), fk_get_u32(proof + 8), fk_get_u32(proof + 12)};
    fk_challenge_answer_pack(answer, &reply);
    return (int32_t)FK_CHALLENGE_ANSWER_BYTES;
}

int32_t fk_robot_key_command(fk_robot_t *robot, const fk_frame_t *frame, uint64_t now_us, uint8_t *answer)
{
    if (frame->type == FK_FRAME_CHALLENGE) {
        return on_challenge(robot, frame->payload, now_us, answer);
    }
    /* A port without a store keeps no key. */
    fk_put_i8(answer, (robot->store != 0) ? take_key(robot, frame->payload, now_us) : (int8_t)FK_STATUS_UNKNOWN);
    return 1;
}
