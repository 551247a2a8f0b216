/* The covariance of the Kalman filter in fk_track.h, which defines F, Q, H, R and the gate: one matrix that x and y
 * share, and one for the heading. The process noise is adapted while the robot swims, so that the predictions of a
 * poor table get less weight.
 */
#ifndef FK_COVARIANCE_H
#define FK_COVARIANCE_H

#include <stdint.h>

#include "fk_profile.h"

#define FK_INSTANTS 4u      /* at which the track keeps states */
#define FK_TRACK_STATES 8u  /* 2 i: pose at instant i, 2 i + 1: speed there */

/* Variances of the position's axes, in m^2 and (m/s)^2, or of the heading, in rad^2 and (rad/s)^2. */
typedef struct {
    float fix;                 /* of a fix at rest */
    float shape;               /* of the profile's own error (fk_profile.h), where its error_share is 1 */
    float gate;                /* margin that the gate adds to the variance of the innovation */
    float process_noise;       /* of a stroke's speed around the table's: the initial value, */
    float process_noise_least; /* the least */
    float process_noise_most;  /* and the largest one */
    float pose;                /* of an unknown pose */
    float speed;               /* of an unknown speed */
} fk_noise_t;

typedef struct {
    const fk_noise_t *noise;
    float matrix[FK_TRACK_STATES][FK_TRACK_STATES]; /* symmetric */
    float process_noise;      /* q: variance of a stroke's speed around the table's prediction */
    float predicted_variance; /* of the newest instant's pose as it was predicted */
} fk_covariance_t;

/* The statistics of an innovation, which is the measured pose minus the expected one. */
typedef struct {
    float cross[FK_TRACK_STATES]; /* covariance of each state with the expected pose: P H^T */
    float variance;               /* of the innovation: H P H^T + R */
} fk_innovation_t;

extern const fk_noise_t fk_noise_position;
extern const fk_noise_t fk_noise_heading;

void fk_covariance_init(fk_covariance_t *covariance, const fk_noise_t *noise);

/* Pose and speed at instant 0 become unknown; there is no other instant. */
void fk_covariance_reset(fk_covariance_t *covariance);

/* Predict instant from + 1, period_s after instant from. resting: 1 = no limb fires in between. */
void fk_covariance_predict(fk_covariance_t *covariance, uint32_t from, float period_s, int32_t resting);

/* The statistics of the innovation of a pose that was measured in the period that begins at instant `from`, within
 * which `fixes` were accepted before. states: 2 x instants. Returns the largest squared innovation that the gate
 * accepts. */
float fk_covariance_innovation(const fk_covariance_t *covariance, const fk_profile_t *profile, uint32_t from, uint32_t states,
                               uint32_t fixes, fk_innovation_t *innovation);

/* Update the covariance by that pose. The caller updates the means, by cross x innovation / variance. */
void fk_covariance_update(fk_covariance_t *covariance, const fk_innovation_t *innovation, uint32_t states);

/* Move the newest instant, newest > 0, to the time of the profile, which belongs to the period before it. */
void fk_covariance_retime(fk_covariance_t *covariance, const fk_profile_t *profile, uint32_t newest);

/* Drop instant 0; the others move up, and `left` of them remain. */
void fk_covariance_marginalise(fk_covariance_t *covariance, uint32_t left);

/* Quadruple the process noise: the robot was not where it had been predicted. */
void fk_covariance_inflate(fk_covariance_t *covariance);

/* The variance of the newest instant's pose if fixes have reduced it to half of the predicted one or less; else
 * -1. */
float fk_covariance_informed(const fk_covariance_t *covariance, uint32_t newest);

/* Adapt the process noise at the end of a period. square: squared prediction error of its end's pose, summed over
 * `axes` axes; part: weight of this period. (Mehra 1970, IEEE Trans. Autom. Control 15(2).) */
void fk_covariance_adapt(fk_covariance_t *covariance, uint32_t newest, float square, float axes, float part);

#endif
