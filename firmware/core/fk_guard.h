/* The guard: limits that no command can raise. It stands between every wish for a pulse and the pins.
 * Its numbers come from the robot's TOML through fk_robot_config.h, at build; the assertions below are what no TOML can
 * exceed. The limits hold on the pins, which the port switches up to FK_PORT_LATE_US after the time that it told.
 */
#ifndef FK_GUARD_H
#define FK_GUARD_H

#include <stdint.h>

#include "fk_planner.h"
#include "fk_robot_config.h"

/* From the time told to the core's tick until the port has switched the pins that this tick asks for. A port that would
 * be later does not begin the pulse, and tells the core. */
#define FK_PORT_LATE_US 200u

/* A limb rests at least FK_REST_MIN_US between pulses, so this many pulses can touch one duty window at most. */
#define FK_GUARD_HISTORY ((FK_DUTY_WINDOW_US + FK_PORT_LATE_US) / FK_REST_MIN_US + 2u)

#define FK_PULSE_CEILING_US 100000u     /* for every robot: a limb of shape memory alloy burns when it is heated on */
#define FK_FIX_FRESH_CEILING_US 500000u
#define FK_FIX_LOST_CEILING_US 2000000u

typedef char fk_pulse_limit_is_a_limit[(FK_PULSE_MAX_US > 0u && FK_PULSE_MAX_US <= FK_PULSE_CEILING_US) ? 1 : -1];
typedef char fk_rest_limit_is_a_limit[(FK_REST_MIN_US >= 100000u) ? 1 : -1];
typedef char fk_duty_limit_is_a_limit[(FK_DUTY_ON_MAX_US < FK_DUTY_WINDOW_US) ? 1 : -1];
typedef char fk_limbs_limit_is_a_limit[(FK_LIMBS_AT_ONCE_MAX >= 1u && FK_LIMBS_AT_ONCE_MAX <= FK_LIMBS_MAX) ? 1 : -1];
typedef char fk_fresh_limit_is_a_limit[(FK_FIX_FRESH_US <= FK_FIX_FRESH_CEILING_US) ? 1 : -1];
typedef char fk_lost_limit_is_a_limit[(FK_FIX_LOST_US <= FK_FIX_LOST_CEILING_US) ? 1 : -1];

/* Each part of the books carries a check over all that it holds. Nothing is allowed, and nothing is entered, where one does
 * not hold: a change within one word of a part never goes unseen, any other one in 2^32 does. */
typedef struct {
    uint64_t start_us[FK_GUARD_HISTORY]; /* ring of each limb's latest pulses */
    uint32_t on_us[FK_GUARD_HISTORY];    /* their lengths; 0 = this place was never used, or the pulse did not begin */
    uint64_t off_us;                     /* when its pin is low for certain after the last one; rest begins here */
    uint16_t next;                       /* place of the next pulse, also the oldest */
    uint16_t was_cut;                    /* that one was cut: the pin was low before any pulse that came later */
    uint32_t check;
} fk_guard_limb_t;

typedef struct {
    fk_guard_limb_t limbs[FK_LIMBS_MAX];
    uint64_t fix_us;      /* capture of the newest position fix; 0 also where there was none */
    uint32_t closed_loop; /* pulses need a fresh fix */
    uint32_t check;       /* over these two */
} fk_guard_t;

/* What a reset must not wipe out, in RAM that the start-up leaves alone: how long each limb was on within the duty window
 * that ended with its last pulse. After a time without supply that RAM holds something else, which the CRC-32 tells. */
typedef struct {
    uint32_t on_us[FK_LIMBS_MAX];
    uint32_t crc;
} fk_guard_persistent_t;

/* How long after time 0 limbs of which nobody knows how hot they are count as cool. */
#define FK_UNKNOWN_HEAT_REST_US                                                                                       \
    ((FK_DUTY_WINDOW_US > FK_REST_MIN_US ? FK_DUTY_WINDOW_US : FK_REST_MIN_US) + FK_PORT_LATE_US)

/* Books of limbs of which nobody knows how hot they are: as if all the heat that is allowed had gone into each just before
 * time 0. */
void fk_guard_init(fk_guard_t *guard);

/* After fk_guard_init: as if all that was kept had happened just now, as nobody knows how long ago it was.
 * @retval 1  done
 * @retval 0  what was kept is damaged or lost: the books stay as they are
 */
int32_t fk_guard_resume(fk_guard_t *guard, const fk_guard_persistent_t *persistent);

/* Keep what the books hold, which are sound. */
void fk_guard_keep(const fk_guard_t *guard, fk_guard_persistent_t *persistent);

/* The next start is not to believe what is kept. */
void fk_guard_lose(fk_guard_persistent_t *persistent);

/* The books were written by another hand, which answers for them: the checks are made to hold. */
void fk_guard_seal(fk_guard_t *guard);

/* The robot follows a path on its own, or no longer. */
void fk_guard_closed_loop(fk_guard_t *guard, int32_t closed);

/* A position fix was taken, a picture of capture_us. */
void fk_guard_note_fix(fk_guard_t *guard, uint64_t capture_us);

/* When the newest fix becomes older than FK_FIX_LOST_US: from then on a closed loop is over. */
uint64_t fk_guard_lost_us(const fk_guard_t *guard);

/* 1 where the books are as this file wrote them, else 0: memory is damaged, nothing in them can be believed. */
int32_t fk_guard_is_sound(const fk_guard_t *guard);

/* May these limbs be heated now? If so the pulse is entered in the books, wholly or not at all.
 * @param limb_mask  bit i = limb i; not 0
 * @param pulse_us   1 to FK_PULSE_MAX_US
 * @param now_us     the robot's clock; never goes back
 * @retval 1   allowed and entered
 * @retval 0   refused: too long, too soon after the last, too much within FK_DUTY_WINDOW_US, too many limbs at once, or
 *             in a closed loop without a fix of the last FK_FIX_FRESH_US
 * @retval -1  refused: the books are damaged
 */
int32_t fk_guard_allow(fk_guard_t *guard, uint8_t limb_mask, uint32_t pulse_us, uint64_t now_us);

/* The pulse that was entered last for these limbs did not begin: it counts as one of no length. */
void fk_guard_not_begun(fk_guard_t *guard, uint8_t limb_mask);

/* All outputs were switched off at now_us: pulses that were still on end there. */
void fk_guard_cut(fk_guard_t *guard, uint64_t now_us);

#endif
