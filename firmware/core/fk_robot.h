/* The robot as one state machine without hardware: frames in, one pulse at a time out, time passed in.
 *
 * A port does four things in a loop: it hands over at most one received frame, calls fk_robot_tick(), does what the
 * outputs say (a pulse is ended by hardware), and sends what fk_robot_take_tx() gives. Its watchdog resets the chip
 * where one turn of the loop takes more than a second.
 *
 * fk_supervisor.h has the states and what leads from one to another. An internal error (FK_FAULT_... in
 * fk_frames_layout.h) switches all limbs off and puts the robot into FAULT, which STATUS reports and only a reset
 * ends.
 *
 * A decision and the stroke that it asks for take two ticks. A decision computes for some time, and the guard must
 * know the time at which the pins switch, so the stroke begins with the time of a tick of its own.
 */
#ifndef FK_ROBOT_H
#define FK_ROBOT_H

#include <stdint.h>

#include "fk_frames.h"
#include "fk_guard.h"
#include "fk_log.h"
#include "fk_store.h"
#include "fk_supervisor.h"
#include "fk_wear_keep.h"

#define FK_TX_BYTES 768u            /* room for answers and events that the port has not yet fetched */

typedef struct {
    uint8_t limb_mask;     /* 0: nothing; else start ONE pulse on these limbs now */
    uint8_t all_off;       /* 1: switch all limbs off now, before anything else */
    uint32_t pulse_us;     /* length of that pulse; its end is a hardware event */
    uint64_t next_tick_us; /* the core needs its next tick at this time at the latest; UINT64_MAX: only on a frame */
} fk_outputs_t;

/* A robot. A port that gives it its memory includes fk_robot_state.h, and looks no further into it. */
typedef struct fk_robot fk_robot_t;

/* Check the table image and start disarmed.
 * @param image  4-byte aligned, stays valid as long as the robot lives
 * @retval 0         ready
 * @retval negative  fk_error_t of fk_tables_open, FK_ERROR_ROBOT where the image is for another robot,
 *                   FK_ERROR_IMAGE_TIMES where its pulse is above the guard's limit, or a whole stroke longer than
 *                   the period, FK_ERROR_IMAGE_COUNT where it has too many states (fk_fit.h). The robot has a fault
 *                   then, but answers; all other functions may be called.
 */
int32_t fk_robot_init(fk_robot_t *robot, const uint8_t *image, uint32_t image_bytes);

/* Why the chip started. Call it after fk_robot_init() and before the first tick.
 * @param reset       FK_RESET_...
 * @param persistent  RAM that no start-up code clears, for the robot to use as long as it lives: the limbs' heat,
 *                    across resets. Where it is damaged or lost no pulse is allowed before
 *                    FK_UNKNOWN_HEAT_REST_US, as without this call
 */
void fk_robot_note_reset(fk_robot_t *robot, uint8_t reset, fk_guard_persistent_t *persistent);

/* Keep the estimate of the limbs' wear across resets, and continue from the one that is kept, if it is sound and of
 * the table in use. Call it after fk_robot_note_reset() and before fk_robot_use_log(). Without this call a reset
 * forgets the estimate.
 * @param learned  RAM that no start-up code clears, for the robot to use as long as it lives
 */
void fk_robot_use_learned(fk_robot_t *robot, fk_wear_persistent_t *learned);

/* Accept tables by radio, and only the owner's commands if there is one. The store has booted, and fk_robot_init() was given
 * its image. Call it before fk_robot_use_log(). A robot whose owner's key is lost is in FAULT. */
void fk_robot_use_store(fk_robot_t *robot, fk_store_t *store);

/* Keep a log, which the command LOG fetches. Call it after fk_robot_note_reset() and before the first tick.
 * @param log  RAM for the robot to use as long as it lives; if no start-up code clears it, the log survives a reset
 */
void fk_robot_use_log(fk_robot_t *robot, fk_log_t *log);

/* One received frame: COBS, without its delimiter. The answer goes to the transmit buffer. Call fk_robot_tick()
 * before the next. */
void fk_robot_on_frame(fk_robot_t *robot, const uint8_t *encoded, uint32_t length, uint64_t now_us);

/* Do what is due at now_us. A tick that makes a decision takes some milliseconds, as long as PLAN_TIME_US allows, and
 * never longer than FK_SEARCH_MOST_US (fk_fit.h); its outputs switch nothing. */
void fk_robot_tick(fk_robot_t *robot, uint64_t now_us, fk_outputs_t *outputs);

/* An armed robot that has received no whole frame for this long disarms. */
#define FK_LINK_SILENT_US 5000000u

/* A port's error for a pulse that it could not begin within FK_PORT_LATE_US. */
#define FK_PULSE_LATE (-16)

/* The pulse that the last tick asked for did not begin, and will not. Call it directly after that tick.
 * @param error  FK_PULSE_LATE: the stroke is refused, as one that the guard refuses. Any other number, -128 to 127,
 *               is the port's own and an internal error
 */
void fk_robot_note_pulse_failed(fk_robot_t *robot, int32_t error);

/* The port's crystal does not run, so that a pulse would not have its length: an internal error. */
void fk_robot_note_clock_failed(fk_robot_t *robot);

/* The connection to the host has ended. A host that only falls silent is noticed by the core, after
 * FK_LINK_SILENT_US. */
void fk_robot_note_link_lost(fk_robot_t *robot);

/* Whether the supply is too low, as often as the port likes. A robot with a low supply disarms and refuses ARM until
 * the supply is sufficient again.
 * @param is_low  1: too low to heat limbs with
 */
void fk_robot_note_supply(fk_robot_t *robot, int32_t is_low);

/* How long the last tick took, measured by the port. The DECISION event carries it. */
void fk_robot_note_tick(fk_robot_t *robot, uint32_t elapsed_us);

/* Take encoded frames to send, whole ones with their delimiters.
 * @param capacity  at least FK_FRAME_ENCODED_MAX, or some frames never go out
 * @retval  bytes written, 0 to capacity
 */
uint32_t fk_robot_take_tx(fk_robot_t *robot, uint8_t *bytes, uint32_t capacity);

/* Frames from fk_robot_take_tx() that the port could not send. STATUS counts them together with those for which
 * the transmit buffer had no room. */
void fk_robot_note_frames_dropped(fk_robot_t *robot, uint32_t frames);

/* Continue from a snapshot in a log, as a host does that replays it. Call it after fk_robot_init() with the same
 * table and fk_robot_use_log().
 * @param snapshot  contents of its SNAPSHOT records without their heads, joined
 * @retval 0   done
 * @retval -1  not a snapshot of such a robot, which must not be used now
 */
int32_t fk_robot_restore(fk_robot_t *robot, const uint8_t *snapshot, uint32_t length);

/* Whether the supervisor allows an event in the robot's present state.
 * @param event  FK_EVENT_..., such as FK_EVENT_PULSE
 * @retval FK_STATUS_OK, or the status with which it would be refused
 */
int8_t fk_robot_may(const fk_robot_t *robot, uint8_t event);

#endif
