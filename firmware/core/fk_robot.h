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

#include "fk_auth.h"
#include "fk_estimator.h"
#include "fk_fit.h"
#include "fk_follow.h"
#include "fk_frames.h"
#include "fk_guard.h"
#include "fk_log.h"
#include "fk_planner.h"
#include "fk_repeats.h"
#include "fk_store.h"
#include "fk_supervisor.h"

#define FK_TX_BYTES 768u            /* room for answers and events that the port has not yet taken */
#define FK_START_DELAY_MAX_US 10000000u
#define FK_CAPTURE_AGE_MAX_US 2000000u
#define FK_PERIOD_MIN_US 500000u
#define FK_PERIOD_MAX_US 5000000u
#define FK_PLAN_TIME_MAX_US 1000000u
#define FK_PLAN_TIME_WATCHDOG_US 800000u /* no search takes longer: the port's watchdog waits for 1 s */
#define FK_TRANSITIONS_LIMIT 10000000u
#define FK_PLAN_FIXED_US 600u        /* of a decision's time, what no transition takes; measured: study chip */
#define FK_TRANSITION_NS 22000u      /* the most that one more transition takes on the chip; measured likewise */

typedef struct {
    uint8_t limb_mask;     /* 0: nothing; else start ONE pulse on these limbs now */
    uint8_t all_off;       /* 1: switch all limbs off now, before anything else */
    uint32_t pulse_us;     /* length of that pulse; its end is a hardware event */
    uint64_t next_tick_us; /* the core needs its next tick at this time at the latest; UINT64_MAX: only on a frame */
} fk_outputs_t;

typedef struct {
    fk_tables_t tables;
    fk_path_t path;
    fk_plan_config_t plan;
    fk_follow_t follow;
    fk_estimator_t estimator;
    fk_guard_t guard;

    fk_guard_kept_t *kept; /* 0: none */
    fk_store_t *store;     /* 0: no tables by radio */
    fk_repeats_t repeats;
    fk_auth_t auth;

    fk_log_t *log;      /* 0: none */
    uint32_t log_mark;  /* its end after the last snapshot */
    uint8_t log_broken; /* something that changes decisions was not logged since then: another one is due */

    uint8_t state;               /* FK_STATE_...; changed by fk_robot_supervise alone */
    uint8_t fault;               /* FK_FAULT_..., the first one since the reset */
    int8_t fault_detail;
    uint8_t reset;               /* FK_RESET_... */
    uint8_t heat_unknown;        /* it started without knowing how hot its limbs were */
    uint8_t supply;              /* FK_SUPPLY_... */
    uint16_t conversation;       /* of the last HELLO */
    uint64_t now_us;             /* the latest time that the port told */
    uint64_t heard_us;           /* when the last whole frame came; of the owner, where there is one */
    uint8_t replays;             /* lives through a log, which says itself when the link was lost */
    uint8_t path_points;         /* points received so far */
    uint8_t path_total;          /* points of the path being received; path is whole when both are equal, not 0 */
    uint8_t resting_action;      /* first action that fires no limb; tables.actions where there is none */
    uint32_t period_us;
    uint64_t next_decision_us;   /* while RUNNING */
    uint32_t decisions;          /* since START */

    uint8_t second_mask;         /* limbs of the stroke's second group, 0: none pending */
    uint64_t second_us;          /* when they fire */
    uint8_t stroke_request;      /* 1 + action asked for by STROKE or a decision, begun by a next tick; 0: none */
    uint64_t stroke_us;          /* when the action asked for last begins, as the estimator was told */
    uint64_t free_us;            /* when the port's pulse timer is free: one pulse at a time */
    uint8_t all_off;             /* the next tick switches everything off */
    uint8_t fired_mask;          /* limbs that the last tick asked the port to heat */
    uint8_t fired_first;         /* 1 + action whose first limbs these are; 0: the second ones of a stroke */

    uint8_t decision_pending;    /* a DECISION event waits for its computing time */
    fk_decision_event_t decision;
    uint8_t refused_pending;
    fk_refused_event_t refused;
    uint8_t ended_pending;
    fk_ended_event_t ended;
    uint8_t event_sequence;

    uint8_t tx[FK_TX_BYTES];
    uint32_t tx_length;

    uint32_t fixes_used;
    uint32_t fixes_refused;
    uint32_t frames_bad;
    uint32_t pulses;
    uint32_t pulses_refused;
    uint32_t answers_dropped;
    uint32_t commands_repeated;
} fk_robot_t;

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
void fk_robot_note_reset(fk_robot_t *robot, uint8_t reset, fk_guard_kept_t *kept);

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

/* Size of fk_robot_t, for a host that holds one without seeing its type. */
uint32_t fk_robot_bytes(void);

/* For fk_commands.c and fk_link.c; a port asks fk_robot_may of FK_EVENT_PULSE whether a pulse may come. */
int32_t fk_robot_command(fk_robot_t *robot, const fk_frame_t *frame, uint64_t now_us, uint8_t *answer);
int8_t fk_robot_may(const fk_robot_t *robot, uint8_t event);
int8_t fk_robot_supervise(fk_robot_t *robot, uint8_t event);
void fk_robot_fault(fk_robot_t *robot, uint8_t fault, int32_t detail);
void fk_robot_note_time(fk_robot_t *robot, uint64_t now_us);
void fk_robot_note_fix(fk_robot_t *robot, uint64_t capture_us, float x_m, float y_m);
uint32_t fk_robot_transitions_within(uint32_t plan_us);
void fk_robot_end_run(fk_robot_t *robot, int8_t status, uint8_t event);
uint32_t fk_robot_rest_us(const fk_robot_t *robot);
void fk_robot_no_more_pulses(fk_robot_t *robot);
void fk_robot_ask_stroke(fk_robot_t *robot, uint8_t action, uint64_t begin_us);

/* For the log: fk_robot_log.c, fk_snapshot.c. The first writes nothing where there is no log. */
#define FK_LOG_NOTHING UINT32_MAX  /* no offset of a record: the command is not logged */
#define FK_LOG_UNFINISHED (-128)    /* status of a command that the robot has not yet done */
void fk_robot_log(fk_robot_t *robot, uint8_t id, const uint8_t *content, uint32_t length);
void fk_robot_log_fault(fk_robot_t *robot);
void fk_robot_log_state(fk_robot_t *robot, uint8_t before, uint8_t event);
void fk_robot_log_stroke(fk_robot_t *robot, uint8_t id, uint8_t action);
#define FK_PULSE_REFUSED 0u  /* by the guard */
#define FK_PULSE_TOLD 1u     /* to the port */
#define FK_PULSE_TOO_LATE 2u /* for the port */
void fk_robot_log_pulse(fk_robot_t *robot, uint8_t limb_mask, uint8_t allowed);
uint32_t fk_robot_log_command(fk_robot_t *robot, const fk_frame_t *frame);
void fk_robot_log_snapshot(fk_robot_t *robot);
int32_t fk_robot_log_answer(const fk_robot_t *robot, const uint8_t *payload, uint8_t *answer);

/* For fk_table_commands.c */
int32_t fk_robot_table_command(fk_robot_t *robot, const fk_frame_t *frame, uint64_t now_us, uint8_t *answer);
void fk_robot_use_tables(fk_robot_t *robot);
int32_t fk_robot_is_at_rest(const fk_robot_t *robot, uint64_t now_us);

/* For fk_link.c: fk_key_commands.c. */
int32_t fk_robot_is_owned(const fk_robot_t *robot);
int8_t fk_robot_admit(fk_robot_t *robot, fk_frame_t *frame);
int32_t fk_robot_key_command(fk_robot_t *robot, const fk_frame_t *frame, uint64_t now_us, uint8_t *answer);

/* For fk_link.c, and what it has for the log */
void fk_robot_send_events(fk_robot_t *robot);
int32_t fk_robot_matters(uint8_t type);

#endif
