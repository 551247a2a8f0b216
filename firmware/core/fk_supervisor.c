#include "fk_supervisor.h"

fk_rule_t fk_supervisor_rule(uint8_t state, uint8_t event)
{
    static const fk_rule_t rules[FK_EVENTS][FK_STATES] = FK_SUPERVISOR_RULES;
    return rules[event - 1u][(state < FK_STATES) ? state : (uint8_t)FK_STATE_FAULT];
}
