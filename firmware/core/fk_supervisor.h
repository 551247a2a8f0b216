/* The supervisor: in which state the robot is and what leads to another one, as one table. It is generated from
 * host/frogkick/link/supervisor.toml, like the table in the documentation (host/docs/pages/reference/link.md).
 */
#ifndef FK_SUPERVISOR_H
#define FK_SUPERVISOR_H

#include <stdint.h>

#include "fk_frames_layout.h"
#include "fk_supervisor_table.h"

typedef struct {
    uint8_t next;   /* FK_STATE_... */
    uint8_t action; /* FK_DO_... */
    int8_t status;  /* FK_STATUS_OK, or why the event is refused */
} fk_rule_t;

/* What an event does in a state.
 * @param state  any number: one that is no state counts as FAULT
 * @param event  FK_EVENT_...
 */
fk_rule_t fk_supervisor_rule(uint8_t state, uint8_t event);

#endif
