/* The robot's state over time: a Kalman filter with fixed-lag smoothing, one for each of x, y and heading, in the
 * world frame. (Anderson and Moore 1979, Optimal Filtering, chapter 7.)
 *
 *   state  pose p and speed v at the last FK_INSTANTS instants, oldest first; an instant is a time at which an action
 *          starts
 *   F      the table predicts the mean; for the covariance over a period T, p' = p + 0.8 T v and v' = 0.7 v
 *   Q      (0.8 T, 0.7) (0.8 T, 0.7)^T q + 0.04 diag(T^2, 1) q for a stroke; q is adapted from innovations (Mehra
 *          1970)
 *   H      fk_profile.h: the pose at any time in a period, from pose and speed at its two ends
 *   R      the variance of a fix, and that of the profile's own error
 *   gate   five standard deviations of the innovation and a margin, for the position and for the heading
 *
 * All instants share one Gaussian estimate (fk_covariance.h), so a late fix corrects the state at its own capture
 * time and all states since. The recent use of each limb is counted from the actions. The Python twin is
 * host/frogkick/estimator/track.py; both give the same bits.
 */
#ifndef FK_TRACK_H
#define FK_TRACK_H

#include <stdint.h>

#include "fk_planner.h"
#include "fk_covariance.h"
#include "fk_wear.h"

#define FK_TRACK_COASTS_MAX 8u     /* periods without an action that are predicted as rest; after more all states are forgotten */
#define FK_COAST_US 200000u       /* how late an action may be announced before its period counts as rest */
#define FK_PERIOD_LEAST_US 50000u /* an action that follows another one sooner replaces it */

typedef struct {
    fk_tables_t *tables;           /* the prediction, with limbs as worn as `wear` estimates */
    uint64_t time_us[FK_INSTANTS]; /* oldest first; the newest is the end of the current period */
    float mean[3][FK_TRACK_STATES]; /* x m, y m, heading rad (any turn): pose and speed at each instant */
    float predicted[3];             /* the newest instant's pose as it was predicted when its period began */
    fk_covariance_t covariance[2];         /* of x and y; of heading */
    fk_wear_t wear;                /* estimate of what limbs have lost */
    float fire_s;                  /* from a stroke's start to the end of its last pulse */
    uint16_t limb_use[FK_INSTANTS][FK_LIMBS_MAX];
    uint8_t action[FK_INSTANTS];   /* of the period that begins there; tables->actions: rest, where the table has no such action */
    uint8_t coasted[FK_INSTANTS];  /* 1: no action was given for that period, which is taken as rest */
    uint8_t fixes[FK_INSTANTS];    /* accepted within that period; 255: or more */
    uint8_t count;                 /* instants: 0 (no state is known) or 2 to FK_INSTANTS */
    uint8_t learned;               /* periods from which the process noise was adapted; 3: or more */
    uint8_t prediction_valid;      /* 1: `predicted` was computed from a known state, and its error is not learned from yet */
    uint8_t resting_action;        /* first action that fires no limb; tables->actions where there is none */
} fk_track_t;

/* tables must outlive the track. learn: FK_LEARN_... */
void fk_track_init(fk_track_t *track, fk_tables_t *tables, uint8_t learn);

/* Forget all states and the adapted process noise; keep the estimate of wear. */
void fk_track_restart(fk_track_t *track);

/* Whether wear is estimated. learn: FK_LEARN_...; OFF forgets the estimate, HELD keeps the limbs' shares and
 * forgets the rest. */
void fk_track_learn(fk_track_t *track, uint8_t learn);

/* Forget all states; keep the process noise and the estimate of wear. */
void fk_track_forget(fk_track_t *track);

/* Predict periods of rest until at_us is at most FK_COAST_US after the newest instant; after FK_TRACK_COASTS_MAX
 * of them forget all states. */
void fk_track_coast(fk_track_t *track, uint64_t at_us);

/* Begin at rest at at_us with an unknown pose. */
void fk_track_begin(fk_track_t *track, uint64_t at_us);

/* An action begins at at_us, at most FK_COAST_US after the newest instant, which moves to that time. */
void fk_track_act(fk_track_t *track, uint64_t at_us, uint8_t action);

/* Learn from the current period, which the next action will end at at_us: adapt the process noise and the estimate of
 * wear. A decision calls it before it plans, so that it plans with what the last stroke has shown; fk_track_act() does
 * it otherwise. The track must have states. */
void fk_track_end_period(fk_track_t *track, uint64_t at_us);

/* Restart from this pose alone; actions and limb use are kept. at_us: not before the oldest instant. */
void fk_track_reset_pose(fk_track_t *track, uint64_t at_us, const float *pose);

/* Correct all states by a pose (x, y, heading) measured at at_us, not before the oldest instant.
 * gated: 1 = refuse one outside the gate
 * @retval 1  accepted
 * @retval 0  refused, nothing changed */
int32_t fk_track_update(fk_track_t *track, uint64_t at_us, const float *pose, int32_t gated);

/* Pose and speed, three each, at at_us: not before the oldest instant. */
void fk_track_state(const fk_track_t *track, uint64_t at_us, float *pose, float *speed);

/* Recent use of each limb, FK_LIMBS_MAX values, for an action that begins at at_us. */
const uint16_t *fk_track_limb_use(const fk_track_t *track, uint64_t at_us);

#endif
