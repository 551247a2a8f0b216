/* PATH: the path to follow, in parts. A path that arrives during a run is collected beside the one that is followed,
 * and replaces it when it is complete, at the next decision: fk_robot_use_coming().
 */
#include "fk_robot_state.h"

static int8_t take_path(fk_path_t *path, uint8_t *points, uint8_t *total, const uint8_t *payload, uint32_t length)
{
    fk_path_command_t command;
    fk_path_command_unpack(payload, &command);
    if (command.count < 1u || command.count > FK_PATH_ROWS_MAX ||
        length != FK_PATH_COMMAND_BYTES + command.count * FK_PATH_ROW_BYTES) {
        return FK_STATUS_LENGTH;
    }
    /* A part that begins at point 0 starts a new path; any other must continue where the last one ended. */
    uint32_t last = (uint32_t)command.first + command.count;
    if (command.total < 2u || command.total > FK_PATH_POINTS_MAX || last > command.total ||
        (command.first != 0u && (command.first != *points || command.total != *total))) {
        return FK_STATUS_VALUE;
    }
    for (uint32_t i = 0u; i < command.count; ++i) {
        fk_path_row_t row;
        fk_path_row_unpack(payload + FK_PATH_COMMAND_BYTES + i * FK_PATH_ROW_BYTES, &row);
        if (!fk_is_finite_within(row.x_m, -FK_FIX_FIELD_M, FK_FIX_FIELD_M) ||
            !fk_is_finite_within(row.y_m, -FK_FIX_FIELD_M, FK_FIX_FIELD_M) ||
            !fk_is_finite_within(row.tangent_rad, -4.0f, 4.0f)) {
            /* Rows before this one have overwritten the earlier path, so now there is none. */
            *points = 0u;
            *total = 0u;
            path->count = 0u;
            return FK_STATUS_VALUE;
        }
        path->x_m[command.first + i] = row.x_m;
        path->y_m[command.first + i] = row.y_m;
        path->tangent_rad[command.first + i] = row.tangent_rad;
    }
    *total = command.total;
    *points = (uint8_t)last;
    path->count = (*points == *total) ? *total : 0u;
    return FK_STATUS_OK;
}

int32_t fk_robot_path_command(fk_robot_t *robot, const uint8_t *payload, uint32_t length, uint8_t *answer)
{
    fk_path_answer_t reply;
    reply.status = fk_robot_may(robot, FK_EVENT_PATH);
    if (robot->state == FK_STATE_RUNNING) {
        reply.status = take_path(&robot->coming, &robot->coming_points, &robot->coming_total, payload, length);
        reply.received = robot->coming_points;
    } else {
        if (reply.status == FK_STATUS_OK) {
            reply.status = take_path(&robot->path, &robot->path_points, &robot->path_total, payload, length);
        }
        reply.received = robot->path_points;
    }
    fk_path_answer_pack(answer, &reply);
    return (int32_t)FK_PATH_ANSWER_BYTES;
}
