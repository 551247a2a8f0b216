#include "fk_profile.h"

#define FK_GLIDE_PART 0.41666667f /* integral of (u + u^2) / 2 over u = 0 to 1 */
#define FK_FIRE_MOST 0.5f         /* of the period */

float fk_profile_sum(const float *weights, const float *values)
{
    return ((weights[0] * values[0] + weights[1] * values[1]) + weights[2] * values[2]) + weights[3] * values[3];
}

void fk_profile_after(float after_s, fk_profile_t *profile)
{
    static const fk_profile_t end = {{0.0f, 0.0f, 1.0f, 0.0f}, {0.0f, 0.0f, 0.0f, 1.0f}, 0.0f};
    *profile = end;
    profile->pose[3] = after_s;
}

void fk_profile_within(float since_s, float period_s, float fire_s, fk_profile_t *profile)
{
    /* In periods: x from 0 to 1, the limbs fire until `fire`. */
    const float x = since_s / period_s;
    const float rest = (1.0f - x) * (1.0f - x);
    float fire = fire_s / period_s;
    if (fire > FK_FIRE_MOST) {
        fire = FK_FIRE_MOST;
    }
    const float half_fire = 0.5f * fire;
    const float glide = 1.0f - fire;
    const float glide_part = FK_GLIDE_PART * glide;
    /* The glide begins at the speed: distance x of_way + speed at the start x of_start + speed at the end x
     * of_end. */
    const float of_way = 1.0f / (half_fire + glide_part);
    const float of_start = -half_fire * of_way;
    const float of_end = -(glide - glide_part) * of_way;
    float area;      /* distance so far due to the speed at which the glide begins, in periods, */
    float start;     /* due to the speed at the start, */
    float end;       /* and due to that at the end */
    float share;     /* parts of these three speeds in the speed now */
    float share_start;
    float share_end;
    if (x <= fire) {
        share = x / fire;
        area = 0.5f * (x * share);
        start = x - area;
        end = 0.0f;
        share_start = 1.0f - share;
        share_end = 0.0f;
        profile->error_share = share * rest;
    } else {
        const float s = (x - fire) / glide;
        const float u = 1.0f - s;
        const float curve = glide * ((s - 0.75f * (s * s)) + 0.16666667f * ((s * s) * s));
        area = half_fire + curve;
        start = half_fire;
        end = (x - fire) - curve;
        share = 0.5f * (u * (1.0f + u));
        share_start = 0.0f;
        share_end = 1.0f - share;
        profile->error_share = rest;
    }
    profile->pose[2] = area * of_way;
    profile->pose[0] = 1.0f - profile->pose[2];
    profile->pose[1] = (start + area * of_start) * period_s;
    profile->pose[3] = (end + area * of_end) * period_s;
    profile->speed[2] = share * of_way / period_s;
    profile->speed[0] = -profile->speed[2];
    profile->speed[1] = share_start + share * of_start;
    profile->speed[3] = share_end + share * of_end;
}
