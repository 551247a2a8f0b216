/* The measurement model H of the Kalman filter in fk_track.h: pose and speed at a time within a period as weighted
 * sums of those at its two ends. World frame, each axis by itself.
 *
 * The speed is assumed to change linearly while the limbs fire, then to decay towards the speed at the end as (u +
 * u^2) / 2, with u falling from 1 to 0; the distance between the two poses determines the speed at which the glide
 * begins. Compared with the simulated rods the error is at most 0.32 mm and 0.26 degrees RMS, and 0.01 mm in the last
 * quarter of a period. In the recorded runs of the hardware, fixes deviate from it by 0.74 mm and 0.94 degrees RMS.
 */
#ifndef FK_PROFILE_H
#define FK_PROFILE_H

#include <stdint.h>

/* Weights of pose and speed at the start, pose and speed at the end, in this order. */
typedef struct {
    float pose[4];  /* 1, s, 1, s */
    float speed[4]; /* 1/s, 1, 1/s, 1 */
    float error_share;    /* share of the profile's own error: 0 at both ends, below 1 between */
} fk_profile_t;

/* Weights at since_s after the start of a period: 0 <= since_s <= period_s, period_s > 0. Limbs fire for fire_s >
 * 0. */
void fk_profile_within(float since_s, float period_s, float fire_s, fk_profile_t *profile);

/* Weights at after_s >= 0 after the end of a period, from where the speed is assumed constant. */
void fk_profile_after(float after_s, fk_profile_t *profile);

/* weights[0] * values[0] + ... + weights[3] * values[3], from the left */
float fk_profile_sum(const float *weights, const float *values);

#endif
