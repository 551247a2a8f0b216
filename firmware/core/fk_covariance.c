#include "fk_covariance.h"

/* Elements of F: an error of the speed moves the next pose by 0.8 x the period, and 0.7 of it remains at the next
 * instant. In simulated periods these slopes lie from 0.67 to 0.93 and from 0.46 to 0.87. */
#define FK_F_POSE 0.8f
#define FK_F_SPEED 0.7f
#define FK_NOISE_APART 0.2f   /* share of the process noise's deviation that pose and speed get independently */
#define FK_NOISE_RESTING 0.0625f /* factor of the process noise in a period of rest */
#define FK_SHAPE_OF_NOISE_S2 0.0064f /* (0.08 s)^2: the profile errs more where the table does */
#define FK_SHAPE_COMMON 0.3f /* fixes of one period share that error, so each further one counts less */
#define FK_GATE 25.0f        /* (5 standard deviations)^2 */
#define FK_INFORMED 0.5f     /* a period is learned from if fixes removed this share of the predicted variance */
#define FK_RATIO_MOST 9.0f    /* largest ratio of a period's process noise to the present one that is learned from */
#define FK_NOISE_INFLATION 4.0f   /* factor of the process noise after the pose was reset to outliers */

/* Standard deviations. A fix at rest: 0.2 mm, 0.2 degrees, as measured. Shape: 0.6 mm, degrees. Gate: 3 mm,
 * degrees. Process noise: 10 (0.3 to 60) mm/s, degrees/s. Unknown: 0.1 m, 1 rad, 50 mm/s, 1 rad/s. */
const fk_noise_t fk_noise_position = {4e-8f, 3.6e-7f, 9e-6f, 1e-4f, 9e-8f, 3.6e-3f, 0.01f, 2.5e-3f};
const fk_noise_t fk_noise_heading = {1.2185e-5f,  1.0966e-4f, 2.7416e-3f, 0.030462f,
                                     2.7416e-5f, 1.0966f,    1.0f,       1.0f};

void fk_covariance_init(fk_covariance_t *covariance, const fk_noise_t *noise)
{
    covariance->noise = noise;
    covariance->process_noise = noise->process_noise;
}

static void put(fk_covariance_t *covariance, uint32_t i, uint32_t j, float value)
{
    covariance->matrix[i][j] = value;
    covariance->matrix[j][i] = value;
}

void fk_covariance_reset(fk_covariance_t *covariance)
{
    put(covariance, 0u, 0u, covariance->noise->pose);
    put(covariance, 0u, 1u, 0.0f);
    put(covariance, 1u, 1u, covariance->noise->speed);
}

void fk_covariance_predict(fk_covariance_t *covariance, uint32_t from, float period_s, int32_t resting)
{
    const uint32_t now = 2u * from;
    const uint32_t then = now + 2u;
    const float pose_gain_s = FK_F_POSE * period_s;
    const float apart_s = FK_NOISE_APART * period_s;
    const float process_noise = (resting != 0) ? FK_NOISE_RESTING * covariance->process_noise : covariance->process_noise;
    for (uint32_t i = 0u; i < then; ++i) {
        const float speed = covariance->matrix[i][now + 1u];
        put(covariance, i, then, covariance->matrix[i][now] + pose_gain_s * speed);
        put(covariance, i, then + 1u, FK_F_SPEED * speed);
    }
    const float *pose = covariance->matrix[then];
    const float *speed = covariance->matrix[then + 1u];
    covariance->predicted_variance =
        (pose[now] + pose_gain_s * pose[now + 1u]) + (pose_gain_s * pose_gain_s + apart_s * apart_s) * process_noise;
    put(covariance, then, then, covariance->predicted_variance);
    put(covariance, then, then + 1u, (speed[now] + pose_gain_s * speed[now + 1u]) + (FK_F_SPEED * pose_gain_s) * process_noise);
    put(covariance, then + 1u, then + 1u,
        FK_F_SPEED * speed[now + 1u] + (FK_F_SPEED * FK_F_SPEED + FK_NOISE_APART * FK_NOISE_APART) * process_noise);
}

float fk_covariance_innovation(const fk_covariance_t *covariance, const fk_profile_t *profile, uint32_t from, uint32_t states,
                               uint32_t fixes, fk_innovation_t *innovation)
{
    for (uint32_t i = 0u; i < states; ++i) {
        innovation->cross[i] = fk_profile_sum(profile->pose, covariance->matrix[i] + 2u * from);
    }
    /* A pose becomes unknown before its variance reaches 0.3 m^2 or 30 rad^2 (FK_FIX_UNKNOWN_US), so rounding
     * makes `expected` too small by less than 2e-8 m^2 or 2e-6 rad^2: the sum with the variance of a fix stays
     * positive. */
    const float expected = fk_profile_sum(profile->pose, innovation->cross + 2u * from);
    const float shape = (covariance->noise->shape + FK_SHAPE_OF_NOISE_S2 * covariance->process_noise) *
                        (profile->error_share * profile->error_share) * (1.0f + FK_SHAPE_COMMON * (float)fixes);
    innovation->variance = expected + (covariance->noise->fix + shape);
    return FK_GATE * (innovation->variance + covariance->noise->gate);
}

void fk_covariance_update(fk_covariance_t *covariance, const fk_innovation_t *innovation, uint32_t states)
{
    const float weight = 1.0f / innovation->variance;
    for (uint32_t i = 0u; i < states; ++i) {
        const float gain = innovation->cross[i] * weight;
        for (uint32_t j = 0u; j <= i; ++j) {
            put(covariance, i, j, covariance->matrix[i][j] - gain * innovation->cross[j]);
        }
    }
}

void fk_covariance_retime(fk_covariance_t *covariance, const fk_profile_t *profile, uint32_t newest)
{
    const uint32_t then = 2u * newest;
    const uint32_t now = then - 2u;
    float pose[FK_TRACK_STATES];
    float speed[FK_TRACK_STATES];
    for (uint32_t i = 0u; i < then + 2u; ++i) {
        pose[i] = fk_profile_sum(profile->pose, covariance->matrix[i] + now);
        speed[i] = fk_profile_sum(profile->speed, covariance->matrix[i] + now);
    }
    for (uint32_t i = 0u; i < then; ++i) {
        put(covariance, i, then, pose[i]);
        put(covariance, i, then + 1u, speed[i]);
    }
    put(covariance, then, then, fk_profile_sum(profile->pose, pose + now));
    put(covariance, then, then + 1u, fk_profile_sum(profile->speed, pose + now));
    put(covariance, then + 1u, then + 1u, fk_profile_sum(profile->speed, speed + now));
}

void fk_covariance_marginalise(fk_covariance_t *covariance, uint32_t left)
{
    for (uint32_t i = 0u; i < 2u * left; ++i) {
        for (uint32_t j = 0u; j < 2u * left; ++j) {
            covariance->matrix[i][j] = covariance->matrix[i + 2u][j + 2u];
        }
    }
}

static void put_process_noise(fk_covariance_t *covariance, float process_noise)
{
    const fk_noise_t *noise = covariance->noise;
    const float most = (process_noise > noise->process_noise_most) ? noise->process_noise_most : process_noise;
    covariance->process_noise = (most < noise->process_noise_least) ? noise->process_noise_least : most;
}

void fk_covariance_inflate(fk_covariance_t *covariance)
{
    put_process_noise(covariance, FK_NOISE_INFLATION * covariance->process_noise);
}

float fk_covariance_informed(const fk_covariance_t *covariance, uint32_t newest)
{
    const float left = covariance->matrix[2u * newest][2u * newest];
    return (left <= (1.0f - FK_INFORMED) * covariance->predicted_variance) ? left : -1.0f;
}

void fk_covariance_adapt(fk_covariance_t *covariance, uint32_t newest, float square, float axes, float part)
{
    const float reduced = covariance->predicted_variance - covariance->matrix[2u * newest][2u * newest];
    if (!(reduced > FK_INFORMED * covariance->predicted_variance)) {
        return;
    }
    float ratio = square / (axes * reduced);
    if (ratio > FK_RATIO_MOST) {
        ratio = FK_RATIO_MOST;
    }
    put_process_noise(covariance, covariance->process_noise * (1.0f + part * (ratio - 1.0f)));
}
