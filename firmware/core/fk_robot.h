/* The robot as one state machine without hardware: frames in, one pulse at a time out, time passed in.
 *
 * A port does four things in a loop: hand over received frames, call fk_robot_tick, start the pulse that outputs
 * ask for (its end is the port's hardware event), and send what fk_robot_take_tx gives. Its watchdog resets it where
 * the loop does not come round within a second.
 *
 * In which state the robot is and what leads to another one: fk_supervisor.h. An internal error, of which there is a list
 * in fk_frames_layout.h, switches all off and stays, told by STATUS, until the next reset.
 *
 * A decision and the stroke that it asks for are two ticks: a decision computes for a while, and the guard's books
 * must hold the time at which the pins really switch, so the stroke is begun with the time of its own tick.
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

#define FK_TX_BYTES 768u            /* room for answers and events that the port has not yet taken */

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
 *                   the period. The robot has a fault then, but answers; all other functions may be called.
 */
int32_t fk_robot_init(fk_robot_t *robot, const uint8_t *image, uint32_t image_bytes);

/* Why the port started, after fk_robot_init and before the first tick.
 * @param reset  FK_RESET_...
 * @param kept   RAM that no start-up clears, for the robot to use as long as it lives: it holds how hot the limbs may
 *               be, over resets. Where it does not, they count as fully heated at time 0, as they do without this call
 */
void fk_robot_note_reset(fk_robot_t *robot, uint8_t reset, fk_guard_persistent_t *persistent);

/* Keep what is learned of the limbs, and go on from it where it is whole and of the table in use. After fk_robot_note_reset and
 * before fk_robot_use_log.
 * @param learned  RAM that no start-up clears, for the robot to use as long as it lives; without this call a reset forgets
 */
void fk_robot_use_learned(fk_robot_t *robot, fk_wear_persistent_t *learned);

/* Take tables by radio. The store has booted, and fk_robot_init was given its image. */
void fk_robot_use_store(fk_robot_t *robot, fk_store_t *store);

/* Keep a log, which LOG fetches. After fk_robot_note_reset and before the first tick.
 * @param log  RAM for the robot to use as long as it lives; where no start-up clears it, it goes on over a reset
 */
void fk_robot_use_log(fk_robot_t *robot, fk_log_t *log);

/* Take one received frame: COBS, without its delimiter. Answers go to the transmit buffer. */
void fk_robot_on_frame(fk_robot_t *robot, const uint8_t *encoded, uint32_t length, uint64_t now_us);

/* Do what is due at now_us. A decision computes for up to some milliseconds in here. */
void fk_robot_tick(fk_robot_t *robot, uint64_t now_us, fk_outputs_t *outputs);

/* An armed robot that has heard no whole frame for so long disarms. */
#define FK_LINK_SILENT_US 5000000u

/* What a port tells of a pulse that it could not begin within FK_PORT_LATE_US. */
#define FK_PULSE_LATE (-16)

/* The pulse that the last tick asked for did not begin, and will not. Directly after that tick.
 * @param error  FK_PULSE_LATE: a refused stroke, as one that the guard refuses. Another number of the port's own, -128
 *               to 127: an internal error
 */
void fk_robot_note_pulse_failed(fk_robot_t *robot, int32_t error);

/* The port's clock is not exact, so that no pulse would last its time: an internal error. */
void fk_robot_note_clock_failed(fk_robot_t *robot);

/* The connection to the host ended. The core sees by itself where a host only falls silent, after FK_LINK_SILENT_US. */
void fk_robot_note_link_lost(fk_robot_t *robot);

/* What the port sees of the supply, as often as it likes. A robot whose supply is too low disarms, and is not armed until it
 * is well again.
 * @param is_low  1: too low to heat with
 */
void fk_robot_note_supply(fk_robot_t *robot, int32_t is_low);

/* How long the last tick took, measured by the port; travels in the DECISION event. */
void fk_robot_note_tick(fk_robot_t *robot, uint32_t elapsed_us);

/* Take encoded frames to send.
 * @retval  bytes written, 0 to capacity
 */
uint32_t fk_robot_take_tx(fk_robot_t *robot, uint8_t *bytes, uint32_t capacity);

/* Frames that fk_robot_take_tx gave and that the port could not send: STATUS counts them with those that found no room. */
void fk_robot_note_frames_dropped(fk_robot_t *robot, uint32_t frames);

/* Go on from a snapshot of a log, as a host does that decides again. After fk_robot_init with the same table, and
 * fk_robot_use_log.
 * @param snapshot  contents of its SNAPSHOT records without their heads, one behind the other
 * @retval 0   done
 * @retval -1  no such snapshot; the robot is not to be used
 */
int32_t fk_robot_restore(fk_robot_t *robot, const uint8_t *snapshot, uint32_t length);

/* Whether an event's command or pulse is possible in the robot's present state.
 * @param event  FK_EVENT_..., as FK_EVENT_PULSE
 * @retval FK_STATUS_OK, or what it would be refused with
 */
int8_t fk_robot_may(const fk_robot_t *robot, uint8_t event);

#endif
