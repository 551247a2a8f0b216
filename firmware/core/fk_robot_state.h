/* The members of a robot, and the functions that the core's own files call of each other. A port includes this header
 * to reserve memory for a robot; it calls only what fk_robot.h declares.
 *
 * The functions are grouped by file, in the order of dependence: a file calls only files above its own. A test
 * enforces that there is no cycle.
 */
#ifndef FK_ROBOT_STATE_H
#define FK_ROBOT_STATE_H

#include "fk_auth.h"
#include "fk_estimator.h"
#include "fk_fit.h"
#include "fk_follow.h"
#include "fk_planner.h"
#include "fk_duplicates.h"
#include "fk_robot.h"

#define FK_START_DELAY_MAX_US 10000000u
#define FK_CAPTURE_AGE_MAX_US 2000000u
#define FK_PERIOD_MIN_US 500000u
#define FK_PERIOD_MAX_US 5000000u
#define FK_PLAN_TIME_MAX_US 1000000u
#define FK_PLAN_TIME_WATCHDOG_US 600000u /* the longest time of a plan that can be set */
#define FK_TRANSITIONS_LIMIT 10000000u
#define FK_PLAN_FIXED_US 600u        /* part of a decision's time that does not depend on transitions; measured by: study chip */
/* The longest time of one more transition on the chip when zig's clang builds the image, measured likewise with the route cost
 * and tables that frogkick makes. In an image of GCC it is up to a quarter longer, and with the paper's cost it is 46 us for a
 * path of 100 points: a plan of limited time takes that much longer there. All builds and costs use one number, so that all
 * decide alike. fk_fit_transitions() has what holds for all of them, and for any table. */
#define FK_TRANSITION_NS 26000u

struct fk_robot {
    fk_tables_t tables;
    fk_path_t path;
    fk_plan_config_t plan;
    uint32_t transitions_most; /* by the table: fk_fit_transitions() */
    fk_follow_t follow;
    fk_estimator_t estimator;
    fk_guard_t guard;

    fk_guard_persistent_t *persistent; /* 0: none */
    fk_wear_persistent_t *learned;     /* 0: none */
    fk_store_t *store;     /* 0: no tables by radio */
    fk_duplicates_t duplicates;
    fk_auth_t auth;

    fk_log_t *log;      /* 0: none */
    uint32_t log_mark;  /* its end after the last snapshot */
    uint8_t log_broken; /* something that changes decisions was not logged since then: a snapshot is due */

    uint8_t state;               /* FK_STATE_...; changed by fk_robot_supervise alone */
    uint8_t fault;               /* FK_FAULT_..., the first one since the reset */
    int8_t fault_detail;
    uint8_t reset;               /* FK_RESET_... */
    uint8_t heat_unknown;        /* the limbs' heat was unknown at the start */
    uint8_t supply;              /* FK_SUPPLY_... */
    uint64_t now_us;             /* the latest time that the port has passed in */
    uint64_t heard_us;           /* when the last whole frame came; where the robot has an owner, the last of the owner's */
    uint8_t replays;             /* 1: it replays a log, which holds by itself when the link was lost */
    fk_path_t coming;            /* a PATH that arrives during a run; complete where its count is not 0 */
    uint8_t coming_points;       /* as path_points */
    uint8_t coming_total;
    uint8_t path_points;         /* points received so far */
    uint8_t path_total;          /* points of the path being received; it is complete when both are equal and not 0 */
    uint8_t resting_action;      /* first action that fires no limb; tables.actions where there is none */
    uint32_t period_us;
    uint64_t next_decision_us;   /* while RUNNING */
    uint32_t decisions;          /* since START */

    uint8_t second_mask;         /* limbs of the stroke's second group that are still to fire; 0: none */
    uint64_t second_us;          /* when they fire */
    uint8_t stroke_request;      /* 1 + action asked for by STROKE or a decision, begun by a next tick; 0: none */
    uint64_t stroke_us;          /* when the action that was asked for last begins, as the estimator has it */
    uint64_t free_us;            /* from when the port's one pulse timer is free */
    uint8_t all_off;             /* the next tick switches everything off */
    uint8_t off_again;           /* the same, and all is off already: nothing is logged */
    uint8_t fired_mask;          /* limbs that the last tick asked the port to heat; 0: none */
    uint8_t fired_first;         /* 1 + action whose first limbs these are; 0: its second ones */

    uint8_t decision_pending;    /* a DECISION event waits to be sent, with its computing time */
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
};

/* fk_snapshot.c */
void fk_robot_log_snapshot(const fk_robot_t *robot);

/* fk_robot_log.c. Nothing is written where there is no log. */
#define FK_LOG_UNFINISHED (-128)   /* status of a command that the robot has not yet done */
#define FK_PULSE_REFUSED 0u  /* by the guard */
#define FK_PULSE_ASKED 1u    /* of the port */
#define FK_PULSE_TOO_LATE 2u /* for the port */
int32_t fk_robot_changes_state(uint8_t type);
int32_t fk_robot_is_owned(const fk_robot_t *robot);
int32_t fk_robot_is_still(const fk_robot_t *robot, uint8_t event);
uint32_t fk_robot_rest_us(const fk_robot_t *robot);
void fk_robot_log(fk_robot_t *robot, uint8_t id, const uint8_t *content, uint32_t length);
void fk_robot_log_fault(fk_robot_t *robot);
void fk_robot_log_state(fk_robot_t *robot, uint8_t before, uint8_t event);
void fk_robot_log_stroke(fk_robot_t *robot, uint8_t id, uint8_t action);
void fk_robot_log_pulse(fk_robot_t *robot, uint8_t limb_mask, uint8_t allowed);
int32_t fk_robot_log_command(fk_robot_t *robot, const fk_frame_t *frame, uint32_t *record);
int32_t fk_robot_log_answer(const fk_robot_t *robot, const uint8_t *payload, uint8_t *answer);

/* fk_robot_state.c: no other file changes the state, or asks for a stroke. */
int8_t fk_robot_supervise(fk_robot_t *robot, uint8_t event);
void fk_robot_fault(fk_robot_t *robot, uint8_t fault, int32_t detail);
void fk_robot_no_more_pulses(fk_robot_t *robot);
void fk_robot_use_coming(fk_robot_t *robot);
int32_t fk_is_finite_within(float value, float least, float most);
void fk_robot_ask_stroke(fk_robot_t *robot, uint8_t action, uint64_t begin_us);

/* fk_robot_watch.c */
void fk_robot_end_run(fk_robot_t *robot, int8_t status, uint8_t event);
void fk_robot_note_time(fk_robot_t *robot, uint64_t now_us);

/* fk_events.c */
void fk_robot_send(fk_robot_t *robot, uint8_t type, uint8_t sequence, const uint8_t *payload, uint32_t length);
void fk_robot_send_events(fk_robot_t *robot);

/* fk_robot.c */
void fk_robot_use_tables(fk_robot_t *robot);
void fk_robot_note_fix(fk_robot_t *robot, uint64_t capture_us, float x_m, float y_m);
uint32_t fk_robot_transitions_within(uint32_t plan_us);
int32_t fk_robot_plan(const fk_robot_t *robot, uint8_t depth, const fk_state_t *state, fk_plan_t *plan);

/* fk_table_commands.c */
int32_t fk_robot_is_at_rest(const fk_robot_t *robot, uint64_t now_us);
int32_t fk_robot_table_command(fk_robot_t *robot, const fk_frame_t *frame, uint64_t now_us, uint8_t *answer);

/* fk_key_commands.c */
int8_t fk_robot_admit(fk_robot_t *robot, fk_frame_t *frame);
int32_t fk_robot_key_command(fk_robot_t *robot, const fk_frame_t *frame, uint64_t now_us, uint8_t *answer);

/* fk_path_command.c */
int32_t fk_robot_path_command(fk_robot_t *robot, const uint8_t *payload, uint32_t length, uint8_t *answer);

/* fk_commands.c. The answer, here and above, may lie where the command's payload does: it is written when that has been
 * read. */
int32_t fk_robot_command(fk_robot_t *robot, const fk_frame_t *frame, uint64_t now_us, uint8_t *answer);

#endif
