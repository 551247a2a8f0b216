/* How a robot gets from one instant to the next: pose and speed within a period as weighted sums of those at its ends.
 *
 * The speed is taken to change linearly while the limbs fire, then to fall towards that of the end as (u + u^2) / 2
 * with u = 1 to 0; the distance decides how fast the glide begins. Against the rods this errs by 0.32 mm and 0.26
 * degrees RMS where it is worst, in the last quarter by 0.01 mm; on the recorded runs of the hardware, fixes keep to
 * it within 0.74 mm and 0.94 degrees RMS. World frame, each axis by itself.
 */
#ifndef FK_PROFILE_H
#define FK_PROFILE_H

#include <stdint.h>

/* Weights of pose and speed at the start, pose and speed at the end, in this order. */
typedef struct {
    float pose[4];  /* 1, s, 1, s */
    float speed[4]; /* 1/s, 1, 1/s, 1 */
    float doubt;    /* how much of the profile's own error there is: 0 at both ends, below 1 between */
} fk_profile_t;

/* since_s after the start of a period of period_s > 0, 0 <= since_s <= period_s; limbs fire for fire_s > 0. */
void fk_profile_within(float since_s, float period_s, float fire_s, fk_profile_t *profile);

/* after_s >= 0 after the end: straight on. */
void fk_profile_after(float after_s, fk_profile_t *profile);

/* weights[0] * values[0] + ... + weights[3] * values[3], from the left */
float fk_profile_sum(const float *weights, const float *values);

#endif
