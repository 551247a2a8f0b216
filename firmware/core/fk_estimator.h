/* The robot's state at the time of a decision, from position fixes that are late, lost, duplicate, out of order,
 * noisy or wrong.
 *
 * The Kalman filter in fk_track.h predicts the state from one decision to the next with the table, and corrects it by
 * each fix at its own capture time. Before it stand a duplicate filter and an outlier buffer: a fix outside the gate
 * is refused, but three such fixes in a row that agree with each other reset the pose. The robot was then moved by
 * hand, or the first fix was wrong.
 *
 * The Python twin is host/frogkick/estimator/estimator.py; both give the same bits.
 */
#ifndef FK_ESTIMATOR_H
#define FK_ESTIMATOR_H

#include <stdint.h>

#include "fk_planner.h"
#include "fk_track.h"

#define FK_FIX_STALE_US 500000   /* newest fix older than this at the decision: no estimate */
#define FK_FIX_FUTURE_US 100000  /* newest fix later than the decision by more: no estimate */
#define FK_FIX_UNKNOWN_US 10000000u /* no fix for longer: the pose is unknown, and the next fix resets it */
#define FK_FIX_FIELD_M 1000.0f   /* positions beyond are refused, and headings beyond as many rad */
#define FK_FIX_MARKS 64u         /* latest fixes that a duplicate is compared with: 1 s at 60 Hz */
#define FK_OUTLIERS_MAX 3u         /* consecutive outliers that agree until they reset the pose */
#define FK_OUTLIERS_AGREE_M 0.02f        /* two of them agree within this and the distance that a robot may swim between */
#define FK_OUTLIERS_AGREE_MPS 0.15f
#define FK_OUTLIERS_AGREE_RAD 0.35f
#define FK_OUTLIERS_AGREE_RAD_S 1.5f

typedef struct {
    uint64_t capture_us; /* robot's clock */
    float pose[3];       /* x m, y m, heading rad; world; any turn, wrapped here */
    uint16_t sequence;
} fk_fix_t;

typedef struct {
    fk_track_t track;
    uint64_t action_us;           /* when the last action begins */
    uint64_t newest_us;           /* capture time of the newest accepted fix */
    fk_fix_t outliers[FK_OUTLIERS_MAX]; /* outlier buffer: consecutive fixes outside the gate that agree */
    uint32_t marks[FK_FIX_MARKS]; /* duplicate filter: hashes of the latest fixes; 0: none */
    uint32_t restarts;            /* how often outliers have reset the pose since fk_estimator_init() */
    uint16_t newest_sequence;
    uint8_t action;
    uint8_t action_waits;         /* 1: the last action is not predicted yet */
    uint8_t next_mark;            /* index in marks[] of the next one */
    uint8_t outlier_count;
    uint8_t fixes;                /* accepted since the track began or the pose was reset; 255: or more; 0: no state is known */
} fk_estimator_t;

typedef struct {
    fk_state_t state;      /* at the time asked for; velocity in the body frame */
    uint16_t fix_sequence; /* of the newest fix in it */
    uint8_t fixes;         /* in it, 255: or more; 1: the velocity is unknown and taken as zero */
} fk_estimate_t;

/* tables must outlive the estimator. */
void fk_estimator_init(fk_estimator_t *estimator, fk_tables_t *tables, uint8_t learn);

/* Forget everything but the estimate of wear and the count of restarts. */
void fk_estimator_restart(fk_estimator_t *estimator);

/* Add a fix.
 * @retval 0         accepted
 * @retval negative  FK_STATUS_RANGE: not finite, or beyond FK_FIX_FIELD_M; FK_STATUS_DOUBLE: a duplicate, by sequence
 *                   number and pose; FK_STATUS_OLD: captured before the oldest instant of the track;
 *                   FK_STATUS_OUTLIER: outside the gate */
int32_t fk_estimator_add(fk_estimator_t *estimator, const fk_fix_t *fix);

/* The state at a time.
 * @retval 0         estimate filled
 * @retval negative  FK_STATUS_STALE: the newest fix is more than FK_FIX_STALE_US older or FK_FIX_FUTURE_US newer */
int32_t fk_estimator_at(fk_estimator_t *estimator, uint64_t at_us, fk_estimate_t *estimate);

/* The robot begins an action at at_us; a second call for the same time replaces the action. Allowed without fixes
 * too. Returns at once: the action is predicted at the next call that needs the state. */
void fk_estimator_act(fk_estimator_t *estimator, uint64_t at_us, uint8_t action);

/* Whether wear is estimated. learn: FK_LEARN_..., see fk_track_learn() */
void fk_estimator_learn(fk_estimator_t *estimator, uint8_t learn);

/* 1 where no state is known, or the newest fix is more than age_us older than at_us; else 0. */
int32_t fk_estimator_is_lost(const fk_estimator_t *estimator, uint64_t at_us, uint64_t age_us);

#endif
