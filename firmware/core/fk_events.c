/* Frames into the transmit buffer, and the events that wait to be sent. */
#include "fk_robot_state.h"

void fk_robot_send(fk_robot_t *robot, uint8_t type, uint8_t sequence, const uint8_t *payload, uint32_t length)
{
    uint32_t bytes = fk_frame_encode(type, sequence, payload, length, robot->tx + robot->tx_length,
                                     FK_TX_BYTES - robot->tx_length);
    robot->tx_length += bytes;
    if (bytes == 0u) {
        ++robot->answers_dropped;
    }
}

void fk_robot_send_events(fk_robot_t *robot)
{
    uint8_t payload[FK_PAYLOAD_BYTES_MAX];
    if (robot->decision_pending != 0u) {
        fk_decision_event_pack(payload, &robot->decision);
        fk_robot_send(robot, FK_FRAME_DECISION, robot->event_sequence, payload, FK_DECISION_EVENT_BYTES);
        ++robot->event_sequence;
        robot->decision_pending = 0u;
    }
    if (robot->refused_pending != 0u) {
        fk_refused_event_pack(payload, &robot->refused);
        fk_robot_send(robot, FK_FRAME_REFUSED, robot->event_sequence, payload, FK_REFUSED_EVENT_BYTES);
        ++robot->event_sequence;
        robot->refused_pending = 0u;
    }
    if (robot->ended_pending != 0u) {
        fk_ended_event_pack(payload, &robot->ended);
        fk_robot_send(robot, FK_FRAME_ENDED, robot->event_sequence, payload, FK_ENDED_EVENT_BYTES);
        ++robot->event_sequence;
        robot->ended_pending = 0u;
    }
}
