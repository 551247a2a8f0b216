/* The guard: limits that no command can raise. It stands between every wish for a pulse and the pins.
 * Its numbers come from the robot's TOML through fk_robot_config.h, at build.
 */
#ifndef FK_GUARD_H
#define FK_GUARD_H

#include <stdint.h>

#include "fk_planner.h"
#include "fk_robot_config.h"

/* A limb rests at least FK_REST_MIN_US between pulses, so this many pulses can touch one duty window at most. */
#define FK_GUARD_HISTORY (FK_DUTY_WINDOW_US / FK_REST_MIN_US + 2u)

typedef char fk_pulse_limit_is_a_limit[(FK_PULSE_MAX_US > 0u && FK_PULSE_MAX_US <= 100000u) ? 1 : -1];
typedef char fk_rest_limit_is_a_limit[(FK_REST_MIN_US >= 100000u) ? 1 : -1];
typedef char fk_duty_limit_is_a_limit[(FK_DUTY_ON_MAX_US < FK_DUTY_WINDOW_US) ? 1 : -1];
typedef char fk_limbs_limit_is_a_limit[(FK_LIMBS_AT_ONCE_MAX >= 1u && FK_LIMBS_AT_ONCE_MAX <= FK_LIMBS_MAX) ? 1 : -1];

typedef struct {
    uint64_t start_us[FK_GUARD_HISTORY]; /* ring of each limb's latest pulses */
    uint64_t end_us[FK_GUARD_HISTORY];   /* 0 = this place was never used, and: a limb may have been on until boot */
    uint32_t next;                       /* place of the next pulse, also the oldest */
} fk_guard_limb_t;

typedef struct {
    fk_guard_limb_t limbs[FK_LIMBS_MAX];
} fk_guard_t;

/* Empty books. Which limb was hot before the reset is unknown, so all of them rest first, from time 0 on. */
void fk_guard_init(fk_guard_t *guard);

/* May these limbs be heated now? If so the pulse is entered in the books, wholly or not at all.
 * @param limb_mask  bit i = limb i; not 0
 * @param pulse_us   1 to FK_PULSE_MAX_US
 * @param now_us     the robot's clock; never goes back
 * @retval 1  allowed and entered
 * @retval 0  refused: too long, too soon after the last, too much within FK_DUTY_WINDOW_US, or too many limbs at once
 */
int32_t fk_guard_allow(fk_guard_t *guard, uint8_t limb_mask, uint32_t pulse_us, uint64_t now_us);

/* All outputs were switched off at now_us: pulses that were still on end there. */
void fk_guard_cut(fk_guard_t *guard, uint64_t now_us);

#endif
