/* The commands for tables: TABLE_BEGIN to TABLE_STATUS. */
#include "fk_robot_state.h"
#include "fk_store.h"

/* No limb is on, none is due, and every one has rested since its last pulse. */
int32_t fk_robot_is_at_rest(const fk_robot_t *robot, uint64_t now_us)
{
    if (robot->all_off != 0u) {
        return 0; /* they are to be switched off by the next tick */
    }
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        if (now_us < robot->guard.limbs[limb].off_us + FK_REST_MIN_US) {
            return 0;
        }
    }
    return 1;
}

static int8_t begin(fk_store_t *store, const fk_frame_t *frame)
{
    fk_table_begin_command_t command;
    fk_table_begin_command_unpack(frame->payload, &command);
    const uint32_t hash[FK_SHA256_WORDS] = {command.hash_0, command.hash_1, command.hash_2, command.hash_3,
                                            command.hash_4, command.hash_5, command.hash_6, command.hash_7};
    return fk_store_begin(store, command.length, hash);
}

static int8_t chunk(fk_store_t *store, const fk_frame_t *frame)
{
    fk_table_chunk_command_t command;
    fk_table_chunk_command_unpack(frame->payload, &command);
    return fk_store_chunk(store, command.offset, frame->payload + FK_TABLE_CHUNK_COMMAND_BYTES,
                          frame->payload_length - FK_TABLE_CHUNK_COMMAND_BYTES);
}

static int8_t rollback(fk_store_t *store, const fk_frame_t *frame, int8_t *error)
{
    fk_table_rollback_command_t command;
    fk_table_rollback_command_unpack(frame->payload, &command);
    return fk_store_rollback(store, command.table_crc, error);
}

static int32_t answer_table_status(const fk_store_t *store, uint8_t *answer)
{
    fk_table_status_answer_t reply;
    reply.status = FK_STATUS_OK;
    reply.running = store->running;
    reply.active = store->record.active;
    reply.previous = store->record.previous;
    reply.open = store->open;
    reply.slots = (uint8_t)store->flash->slots;
    reply.slot_bytes = store->flash->slot_bytes;
    reply.running_crc = fk_store_crc32(store, store->running);
    reply.previous_crc = fk_store_crc32(store, store->record.previous);
    reply.built_in_crc = fk_store_crc32(store, FK_STORE_BUILT_IN);
    reply.next_offset = store->next_offset;
    reply.erases_1 = store->record.erases[0];
    reply.erases_2 = store->record.erases[1];
    reply.erases_journal = store->record.journal_erases;
    reply.repairs = store->record.repairs;
    fk_table_status_answer_pack(answer, &reply);
    return (int32_t)FK_TABLE_STATUS_ANSWER_BYTES;
}

/* The commands that change the store: refused while a limb is on or may fire, as erasing flash stops the
 * processor. */
static int8_t change(fk_robot_t *robot, const fk_frame_t *frame, uint64_t now_us, int8_t *error)
{
    fk_store_t *store = robot->store;
    int8_t refusal = fk_robot_may(robot, frame->type);
    if (refusal != FK_STATUS_OK) {
        return refusal;
    }
    if (!fk_robot_is_at_rest(robot, now_us)) {
        return FK_STATUS_STATE;
    }
    switch (frame->type) {
    case FK_FRAME_TABLE_BEGIN:
        return begin(store, frame);
    case FK_FRAME_TABLE_CHUNK:
        return chunk(store, frame);
    case FK_FRAME_TABLE_COMMIT:
        return fk_store_commit(store, error);
    default:
        return rollback(store, frame, error);
    }
}

int32_t fk_robot_table_command(fk_robot_t *robot, const fk_frame_t *frame, uint64_t now_us, uint8_t *answer)
{
    fk_store_t *store = robot->store;
    if (store == 0) { /* a port without one */
        fk_put_i8(answer, FK_STATUS_UNKNOWN);
        return 1;
    }
    if (frame->type == FK_FRAME_TABLE_STATUS) {
        return answer_table_status(store, answer);
    }
    const uint8_t *image = store->image;
    fk_table_begin_answer_t reply; /* the commands that write share this answer */
    reply.error = 0;
    reply.status = change(robot, frame, now_us, &reply.error);
    if (store->image != image) {
        fk_robot_use_tables(robot);
    }
    reply.next_offset = store->next_offset;
    reply.table_crc = robot->tables.image_crc32;
    fk_table_begin_answer_pack(answer, &reply);
    return (int32_t)FK_TABLE_BEGIN_ANSWER_BYTES;
}
