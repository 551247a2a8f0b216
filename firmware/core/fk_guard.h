/* The guard: limits on the limbs' pulses that no command can raise. The core asks fk_guard_allow() before every
 * pulse, and no pulse reaches the port that it has refused: see fire() in fk_robot.c.
 *
 * The limits come from the robot's TOML through fk_robot_config.h when the firmware is built. The assertions below
 * bound what a TOML may say. The limits hold on the pins, which the port may switch up to FK_PORT_LATE_US after the
 * time of the tick.
 *
 * The guard keeps a history of each limb's latest pulses. A pulse is entered when it is allowed, so before the pins
 * switch. Whatever is not known for certain counts as heat: after a reset, a late port, a pulse that was cut.
 */
#ifndef FK_GUARD_H
#define FK_GUARD_H

#include <stdint.h>

#include "fk_planner.h"
#include "fk_robot_config.h"

/* The longest time from the now_us of fk_robot_tick() until the port has switched the pins as that tick's outputs
 * say. A port that would be later does not begin the pulse, and calls fk_robot_note_pulse_failed(). */
#define FK_PORT_LATE_US 200u

/* Pulses of a limb that are remembered. A limb rests at least FK_REST_MIN_US between two pulses, so no more than
 * this many can overlap one duty window. */
#define FK_GUARD_HISTORY ((FK_DUTY_WINDOW_US + FK_PORT_LATE_US) / FK_REST_MIN_US + 2u)

#define FK_PULSE_CEILING_US 100000u     /* of every robot: a limb of shape memory alloy burns if it is heated for longer */
#define FK_FIX_FRESH_CEILING_US 500000u
#define FK_FIX_LOST_CEILING_US 2000000u
#define FK_CHECKED_CEILING 18u          /* pulses of a limb that are remembered, and limbs at once */

typedef char fk_pulse_limit_is_a_limit[(FK_PULSE_MAX_US > 0u && FK_PULSE_MAX_US <= FK_PULSE_CEILING_US) ? 1 : -1];
typedef char fk_rest_limit_is_a_limit[(FK_REST_MIN_US >= 100000u) ? 1 : -1];
typedef char fk_duty_limit_is_a_limit[(FK_DUTY_ON_MAX_US < FK_DUTY_WINDOW_US) ? 1 : -1];
typedef char fk_limbs_limit_is_a_limit[(FK_LIMBS_AT_ONCE_MAX >= 1u && FK_LIMBS_AT_ONCE_MAX <= FK_LIMBS_MAX) ? 1 : -1];
/* From a tick to the pins the chip takes 140 us with 12 pulses and 2 limbs, of the 200 us of FK_PORT_LATE_US, and 7 to 9
 * more for each further pulse or limb. */
typedef char fk_history_limit_is_a_limit[(FK_GUARD_HISTORY + FK_LIMBS_AT_ONCE_MAX <= FK_CHECKED_CEILING) ? 1 : -1];
typedef char fk_fresh_limit_is_a_limit[(FK_FIX_FRESH_US <= FK_FIX_FRESH_CEILING_US) ? 1 : -1];
typedef char fk_lost_limit_is_a_limit[(FK_FIX_LOST_US <= FK_FIX_LOST_CEILING_US) ? 1 : -1];

/* The history is in nine parts, one for each limb and one for the loop, and each part has a checksum over all of
 * its other fields. fk_guard_allow() refuses every pulse while any checksum is wrong, and no function below but
 * fk_guard_init(), fk_guard_resume() and fk_guard_seal() writes to a part whose checksum is wrong. A change within
 * one 32-bit word of a part is always found; of other changes one in 2^32 is not. */
typedef struct {
    uint64_t start_us[FK_GUARD_HISTORY]; /* ring buffer of the limb's latest pulses: when each began */
    uint32_t on_us[FK_GUARD_HISTORY];    /* how long each was on; 0 = entry not used yet, or the pulse did not begin */
    uint64_t off_us;                     /* when the pin is low for certain after the last pulse: its rest begins here */
    uint16_t next;                       /* entry of the next pulse, which is also the oldest one */
    uint16_t was_cut;                    /* 1: all outputs were switched off during the last pulse, before any later one began */
    uint32_t check;
} fk_guard_limb_t;

typedef struct {
    fk_guard_limb_t limbs[FK_LIMBS_MAX];
    uint64_t fix_us;      /* capture time of the newest position fix; 0: there was none */
    uint32_t closed_loop; /* 1: a pulse needs a fresh fix */
    uint32_t check;       /* over fix_us and closed_loop */
} fk_guard_t;

/* What must survive a reset, in RAM that the start-up code does not clear: how long each limb was on within the
 * duty window that ended with its last pulse. After a loss of supply that RAM holds something else, which the
 * CRC-32 shows. */
typedef struct {
    uint32_t on_us[FK_LIMBS_MAX];
    uint32_t crc;
} fk_guard_persistent_t;

/* After a start at which the limbs' heat is unknown: the time from which a limb may be heated as if it were cool. */
#define FK_UNKNOWN_HEAT_REST_US                                                                                       \
    ((FK_DUTY_WINDOW_US > FK_REST_MIN_US ? FK_DUTY_WINDOW_US : FK_REST_MIN_US) + FK_PORT_LATE_US)

/* The limbs' heat is unknown: no pulse before FK_UNKNOWN_HEAT_REST_US. The history is filled as if each limb had been on for
 * all of FK_DUTY_ON_MAX_US from time 0 on. */
void fk_guard_init(fk_guard_t *guard);

/* After fk_guard_init: fill the history as if each limb had been on for its persistent time just before time 0, since
 * nobody knows how long ago that was.
 * @retval 1  done
 * @retval 0  the persistent RAM is damaged or was lost: the history is not changed
 */
int32_t fk_guard_resume(fk_guard_t *guard, const fk_guard_persistent_t *persistent);

/* Write the persistent RAM from the history, which is sound. A reset in the middle leaves a CRC-32 that is wrong. */
void fk_guard_keep(const fk_guard_t *guard, fk_guard_persistent_t *persistent);

/* Make the CRC-32 wrong, so that the limbs' heat is unknown at the next start. */
void fk_guard_invalidate(fk_guard_persistent_t *persistent);

/* Make all checksums right. For whoever has written the structure itself: a snapshot that is restored. */
void fk_guard_seal(fk_guard_t *guard);

/* closed: 1 = the robot follows a path by position fixes, so that each pulse needs a fresh one; 0 = it does not. */
void fk_guard_closed_loop(fk_guard_t *guard, int32_t closed);

/* The estimator took a position fix that was captured at capture_us, as far as its frame says: the time that the frame
 * spent on the link makes it look younger. */
void fk_guard_note_fix(fk_guard_t *guard, uint64_t capture_us);

/* The time from which the newest fix is older than FK_FIX_LOST_US, so that a closed loop must end; 0 where there
 * was no fix. */
uint64_t fk_guard_lost_us(const fk_guard_t *guard);

/* 1 where every checksum is right, else 0: memory is damaged, and the history cannot be relied on. */
int32_t fk_guard_is_sound(const fk_guard_t *guard);

/* How many of a limb's latest pulses may still count at now_us or later; the others have left the duty window. */
uint32_t fk_guard_remembered(const fk_guard_limb_t *limb, uint64_t now_us);

/* May these limbs be heated from now on? If so the pulse is entered in each one's history; else nothing is changed.
 * @param limb_mask  bit i = limb i
 * @param pulse_us   how long
 * @param now_us     the robot's clock, which never goes back
 * @retval 1   allowed and entered
 * @retval 0   refused: no limb, or a pulse of 0 or more than FK_PULSE_MAX_US; less than FK_REST_MIN_US since a limb's
 *             last pulse; more than FK_DUTY_ON_MAX_US within FK_DUTY_WINDOW_US; more than FK_LIMBS_AT_ONCE_MAX limbs
 *             on at once; a history that has no room before heat from before a reset has left the window; or a closed
 *             loop without a fix that is at most FK_FIX_FRESH_US old when the pins switch
 * @retval -1  refused: the history is damaged
 */
int32_t fk_guard_allow(fk_guard_t *guard, uint8_t limb_mask, uint32_t pulse_us, uint64_t now_us);

/* The pulse that was entered last for these limbs did not begin: it counts as one of length 0. */
void fk_guard_not_begun(fk_guard_t *guard, uint8_t limb_mask);

/* All outputs are switched off, now_us being the time of the tick that asks for it: a pulse that is still on ends
 * at the latest FK_PORT_LATE_US after that. */
void fk_guard_cut(fk_guard_t *guard, uint64_t now_us);

#endif
