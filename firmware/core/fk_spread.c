#include "fk_spread.h"

/* What an error of the speed does by the next instant: moves the pose by this part of itself x the period, remains by
 * that part. Slopes of the rods' periods lie from 0.67 to 0.93 and from 0.46 to 0.87. */
#define FK_PULL 0.8f
#define FK_REMAINS 0.7f
#define FK_KICK_APART 0.2f   /* part of a kick that pose and speed get each by itself */
#define FK_KICK_RESTING 0.0625f /* of a kick's variance, in a period without a stroke */
#define FK_SHAPE_OF_KICK_S2 0.0064f /* where the table errs the profile does: (0.08 s)^2 */
#define FK_SHAPE_COMMON 0.3f /* that error is one for all fixes of a period: each further one counts less */
#define FK_GATE 25.0f        /* (5 standard deviations)^2 */
#define FK_INFORMED 0.5f     /* a period tells of kicks if its fixes took this part of the variance */
#define FK_WORD_MOST 9.0f    /* what one period can say of the variance of kicks, in parts of the present one */
#define FK_KICK_DOUBT 4.0f   /* kicks' variance after the robot was somewhere else */

/* A fix: 0.2 mm, 0.2 degrees, measured at rest. Shape: 0.6. Gate: 3. Kick: 10 (0.3 to 60) mm/s, degrees/s. Unknown:
 * 0.1 m, 1 rad, 50 mm/s, 1 rad/s. */
const fk_noise_t fk_noise_position = {4e-8f, 3.6e-7f, 9e-6f, 1e-4f, 9e-8f, 3.6e-3f, 0.01f, 2.5e-3f};
const fk_noise_t fk_noise_heading = {1.2185e-5f,  1.0966e-4f, 2.7416e-3f, 0.030462f,
                                     2.7416e-5f, 1.0966f,    1.0f,       1.0f};

void fk_spread_init(fk_spread_t *spread, const fk_noise_t *noise)
{
    spread->noise = noise;
    spread->kick = noise->kick;
}

static void put(fk_spread_t *spread, uint32_t i, uint32_t j, float value)
{
    spread->covariance[i][j] = value;
    spread->covariance[j][i] = value;
}

void fk_spread_unknown(fk_spread_t *spread)
{
    put(spread, 0u, 0u, spread->noise->pose);
    put(spread, 0u, 1u, 0.0f);
    put(spread, 1u, 1u, spread->noise->speed);
}

void fk_spread_foretell(fk_spread_t *spread, uint32_t from, float period_s, int32_t resting)
{
    const uint32_t now = 2u * from;
    const uint32_t then = now + 2u;
    const float pull_s = FK_PULL * period_s;
    const float apart_s = FK_KICK_APART * period_s;
    const float kick = (resting != 0) ? FK_KICK_RESTING * spread->kick : spread->kick;
    for (uint32_t i = 0u; i < then; ++i) {
        const float speed = spread->covariance[i][now + 1u];
        put(spread, i, then, spread->covariance[i][now] + pull_s * speed);
        put(spread, i, then + 1u, FK_REMAINS * speed);
    }
    const float *pose = spread->covariance[then];
    const float *speed = spread->covariance[then + 1u];
    spread->foretold_variance =
        (pose[now] + pull_s * pose[now + 1u]) + (pull_s * pull_s + apart_s * apart_s) * kick;
    put(spread, then, then, spread->foretold_variance);
    put(spread, then, then + 1u, (speed[now] + pull_s * speed[now + 1u]) + (FK_REMAINS * pull_s) * kick);
    put(spread, then + 1u, then + 1u,
        FK_REMAINS * speed[now + 1u] + (FK_REMAINS * FK_REMAINS + FK_KICK_APART * FK_KICK_APART) * kick);
}

float fk_spread_bearing(const fk_spread_t *spread, const fk_profile_t *profile, uint32_t from, uint32_t states,
                        uint32_t fixes, fk_bearing_t *bearing)
{
    for (uint32_t i = 0u; i < states; ++i) {
        bearing->cross[i] = fk_profile_sum(profile->pose, spread->covariance[i] + 2u * from);
    }
    /* A pose is given up before its variance reaches 0.3 m^2 or 30 rad^2 (FK_FIX_UNKNOWN_US), so rounding takes less
     * than 2e-8 m^2 or 2e-6 rad^2 off what is left of it: the sum with a fix's own variance stays positive. */
    const float expected = fk_profile_sum(profile->pose, bearing->cross + 2u * from);
    const float shape = (spread->noise->shape + FK_SHAPE_OF_KICK_S2 * spread->kick) *
                        (profile->doubt * profile->doubt) * (1.0f + FK_SHAPE_COMMON * (float)fixes);
    bearing->variance = expected + (spread->noise->fix + shape);
    return FK_GATE * (bearing->variance + spread->noise->gate);
}

void fk_spread_correct(fk_spread_t *spread, const fk_bearing_t *bearing, uint32_t states)
{
    const float weight = 1.0f / bearing->variance;
    for (uint32_t i = 0u; i < states; ++i) {
        const float gain = bearing->cross[i] * weight;
        for (uint32_t j = 0u; j <= i; ++j) {
            put(spread, i, j, spread->covariance[i][j] - gain * bearing->cross[j]);
        }
    }
}

void fk_spread_move(fk_spread_t *spread, const fk_profile_t *profile, uint32_t newest)
{
    const uint32_t then = 2u * newest;
    const uint32_t now = then - 2u;
    float pose[FK_TRACK_STATES];
    float speed[FK_TRACK_STATES];
    for (uint32_t i = 0u; i < then + 2u; ++i) {
        pose[i] = fk_profile_sum(profile->pose, spread->covariance[i] + now);
        speed[i] = fk_profile_sum(profile->speed, spread->covariance[i] + now);
    }
    for (uint32_t i = 0u; i < then; ++i) {
        put(spread, i, then, pose[i]);
        put(spread, i, then + 1u, speed[i]);
    }
    put(spread, then, then, fk_profile_sum(profile->pose, pose + now));
    put(spread, then, then + 1u, fk_profile_sum(profile->speed, pose + now));
    put(spread, then + 1u, then + 1u, fk_profile_sum(profile->speed, speed + now));
}

void fk_spread_drop(fk_spread_t *spread, uint32_t left)
{
    for (uint32_t i = 0u; i < 2u * left; ++i) {
        for (uint32_t j = 0u; j < 2u * left; ++j) {
            spread->covariance[i][j] = spread->covariance[i + 2u][j + 2u];
        }
    }
}

static void put_kick(fk_spread_t *spread, float kick)
{
    const fk_noise_t *noise = spread->noise;
    const float most = (kick > noise->kick_most) ? noise->kick_most : kick;
    spread->kick = (most < noise->kick_least) ? noise->kick_least : most;
}

void fk_spread_doubt(fk_spread_t *spread) { put_kick(spread, FK_KICK_DOUBT * spread->kick); }

void fk_spread_learn(fk_spread_t *spread, uint32_t newest, float square, float axes, float part)
{
    const float told = spread->foretold_variance - spread->covariance[2u * newest][2u * newest];
    if (!(told > FK_INFORMED * spread->foretold_variance)) {
        return;
    }
    float word = square / (axes * told);
    if (word > FK_WORD_MOST) {
        word = FK_WORD_MOST;
    }
    put_kick(spread, spread->kick * (1.0f + part * (word - 1.0f)));
}
