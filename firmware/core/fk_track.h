/* Where the robot was, is and will be: a Kalman filter with fixed-lag smoothing, one for each of x, y and heading.
 *
 *   state  pose and speed at the last FK_INSTANTS instants, so that a late fix corrects what was then and all since
 *   F      from instant to instant the table says; its derivative is taken as p' = p + 0.8 T v, v' = 0.7 v
 *   Q      of a stroke: (0.8 T, 0.7) (0.8 T, 0.7)^T q + 0.04 diag(T^2, 1) q; q is learned from innovations
 *   H      fk_profile.h: a pose at any time within a period from pose and speed at its two ends
 *   R      of a fix, and the profile's own error; gate: five standard deviations of the innovation, and a margin
 *
 * An instant is the time of a decision, or of a stroke by command; between two lies a period. The table says how the
 * robot gets from one instant to the next, fk_profile.h what of that it has done at a time in between. All states
 * stand in one Gaussian estimate (fk_covariance.h), so a pose measured at any time corrects every instant that it says
 * something about: one from before the last stroke corrects the state then and with it what followed.
 *
 * World frame. x, y and heading are estimated apart. How much each limb was used lately is counted from the actions.
 */
#ifndef FK_TRACK_H
#define FK_TRACK_H

#include <stdint.h>

#include "fk_planner.h"
#include "fk_covariance.h"
#include "fk_wear.h"

#define FK_TRACK_COASTS_MAX 8u     /* periods without a word that are predicted at once; after more all is forgotten */
#define FK_COAST_US 200000u       /* so late may word of a decision come before the robot counts as resting */
#define FK_PERIOD_LEAST_US 50000u /* an action that follows another one sooner takes its place */

typedef struct {
    fk_tables_t *tables;           /* which tell what limbs do that have worn as `wear` says */
    uint64_t time_us[FK_INSTANTS]; /* oldest first; the newest is the end of the period under way */
    float mean[3][FK_TRACK_STATES]; /* x m, y m, heading rad (any turn); as covariance: pose, speed at each instant */
    float predicted[3];             /* the newest instant's pose, as its period began */
    fk_covariance_t covariance[2];         /* of x and y; of heading */
    fk_wear_t wear;                /* what limbs have lost */
    float fire_s;                  /* from a stroke's start to its last limb's end */
    uint16_t limb_use[FK_INSTANTS][FK_LIMBS_MAX];
    uint8_t action[FK_INSTANTS];   /* of the period that begins there; tables->actions: rest, for which no row is */
    uint8_t coasted[FK_INSTANTS];   /* 1: nobody asked for that period, it is taken as one of rest */
    uint8_t fixes[FK_INSTANTS];    /* taken within that period; 255: or more */
    uint8_t count;                 /* instants: 0 (nothing is known) or 2 to FK_INSTANTS */
    uint8_t learned;               /* periods from which the process noise was learned; 3: or more */
    uint8_t teaches;               /* 1: `predicted` is from a state that was known */
    uint8_t resting_action;        /* first that fires no limb; tables->actions where there is none */
} fk_track_t;

/* tables must outlive the track. learn: FK_LEARN_... */
void fk_track_init(fk_track_t *track, fk_tables_t *tables, uint8_t learn);

/* Nothing is known any more, but what limbs have lost. */
void fk_track_restart(fk_track_t *track);

/* Learn what limbs have lost, or not any more. learn: FK_LEARN_..., of which OFF forgets it, and HELD all but the shares. */
void fk_track_learn(fk_track_t *track, uint8_t learn);

/* Nothing is known any more, but the process noise and what limbs have lost. */
void fk_track_forget(fk_track_t *track);

/* Predict periods of rest until at_us is at most FK_COAST_US after the newest instant, or forget. */
void fk_track_coast(fk_track_t *track, uint64_t at_us);

/* Begin at rest at at_us, somewhere. */
void fk_track_begin(fk_track_t *track, uint64_t at_us);

/* An action begins at at_us, at most FK_COAST_US after the newest instant, which is put there. */
void fk_track_act(fk_track_t *track, uint64_t at_us, uint8_t action);

/* Believe no pose but this one; actions and limb use stay known. at_us: not before the oldest instant. */
void fk_track_reset_pose(fk_track_t *track, uint64_t at_us, const float *pose);

/* Correct all states by a pose (x, y, heading) measured at at_us, not before the oldest instant.
 * gated: 1 = refuse one that is too far from where the robot is expected
 * @retval 1  taken
 * @retval 0  refused, nothing changed */
int32_t fk_track_update(fk_track_t *track, uint64_t at_us, const float *pose, int32_t gated);

/* Pose and speed, three each, at at_us: not before the oldest instant. */
void fk_track_state(const fk_track_t *track, uint64_t at_us, float *pose, float *speed);

/* How much each limb was used, FK_LIMBS_MAX values, for an action that begins at at_us. */
const uint16_t *fk_track_limb_use(const fk_track_t *track, uint64_t at_us);

#endif
