/* The robot's state at a decision's time, from position fixes that are late, lost, doubled, out of order, noisy or wrong.
 *
 * The track (fk_track.h) predicts the state from one decision to the next with the table and corrects it by fixes,
 * each at its own capture time. A fix that is too far from where the robot can be is refused; three in a row that are
 * so and agree with each other are believed, and the track starts again from them: the robot was moved by hand, or the
 * first fix was the wrong one. A fix that was had before changes nothing.
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
#define FK_FIX_UNKNOWN_US 10000000u /* no fix for longer: the pose is unknown, the next fix is believed */
#define FK_FIX_FIELD_M 1000.0f   /* positions beyond are refused, and headings beyond as many rad */
#define FK_FIX_MARKS 64u         /* fixes that a doubled one is looked for in: 1 s at 60 Hz */
#define FK_OUTLIERS_MAX 3u         /* refused fixes that agree until they are believed */
#define FK_OUTLIERS_AGREE_M 0.02f        /* two of them agree within this, and what a robot swims in between */
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
    uint64_t action_us;           /* when the action begins that waits to be predicted */
    uint64_t newest_us;           /* capture of the newest fix taken */
    fk_fix_t outliers[FK_OUTLIERS_MAX]; /* the last fixes that were refused for where they are and agree */
    uint32_t marks[FK_FIX_MARKS]; /* of the last fixes; 0: none */
    uint32_t restarts;            /* times that the track started again from fixes that agree */
    uint16_t newest_sequence;
    uint8_t action;
    uint8_t action_waits;
    uint8_t next_mark;            /* place of the next one */
    uint8_t outlier_count;
    uint8_t fixes;                /* taken since the track began or started again; 255: or more. 0: no state is known */
} fk_estimator_t;

typedef struct {
    fk_state_t state;      /* at the asked time; velocity in the body frame */
    uint16_t fix_sequence; /* newest fix used */
    uint8_t fixes;         /* that it rests on, 255: or more; 1: the velocity is unknown and taken as that of rest */
} fk_estimate_t;

/* tables must outlive the estimator. */
void fk_estimator_init(fk_estimator_t *estimator, fk_tables_t *tables, uint8_t learn);

/* Forget all but what limbs have lost: a run's estimate hangs on nothing that was before it. */
void fk_estimator_restart(fk_estimator_t *estimator);

/* Take a fix.
 * @retval 0         taken
 * @retval negative  FK_STATUS_RANGE: not finite or far outside; FK_STATUS_DOUBLE: had before, by sequence and pose;
 *                   FK_STATUS_OLD: from before the oldest instant of the track; FK_STATUS_OUTLIER: too far from where
 *                   the robot can be */
int32_t fk_estimator_add(fk_estimator_t *estimator, const fk_fix_t *fix);

/* Estimate at a time.
 * @retval 0         estimate filled
 * @retval negative  FK_STATUS_STALE: no fix near enough to at_us */
int32_t fk_estimator_at(fk_estimator_t *estimator, uint64_t at_us, fk_estimate_t *estimate);

/* The robot begins an action at at_us; again for the same time: it does this one instead. Also without fixes.
 * Takes no time: the look-up waits for the next fix or question. */
void fk_estimator_act(fk_estimator_t *estimator, uint64_t at_us, uint8_t action);

/* Learn what limbs have lost, or not any more. learn: FK_LEARN_... */
void fk_estimator_learn(fk_estimator_t *estimator, uint8_t learn);

/* 1 where no fix was taken yet, or the newest is more than age_us older than at_us; else 0. */
int32_t fk_estimator_is_lost(const fk_estimator_t *estimator, uint64_t at_us, uint64_t age_us);

#endif
