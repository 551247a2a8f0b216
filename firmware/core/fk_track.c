#include "fk_track.h"

#define FK_GATE_OPEN 1e30f /* accepts every pose that is not NaN */
#define FK_SPEED_MOST 1000.0f /* m/s, rad/s */

/* Weight of the n-th period whose error is learned from: a running mean at first, then an exponential one. */
static const float learn_parts[4] = {0.5f, 0.33333334f, 0.25f, 0.2f};
static const uint8_t covariance_of[3] = {0u, 0u, 1u}; /* index into covariance[] for x, y, heading */

/* from_us <= to_us. 64 bits are not made a float: the chip has no instruction for that. */
static float seconds(uint64_t from_us, uint64_t to_us)
{
    uint64_t time_us = to_us - from_us;
    return (float)((time_us > UINT32_MAX) ? UINT32_MAX : (uint32_t)time_us) * 1e-6f;
}

void fk_track_init(fk_track_t *track, fk_tables_t *tables, uint8_t learn)
{
    track->tables = tables;
    fk_wear_init(&track->wear, tables, learn);
    track->resting_action = tables->actions;
    for (uint8_t action = tables->actions; action > 0u; --action) {
        fk_action_t masks;
        if (fk_tables_action(tables, (uint8_t)(action - 1u), &masks) == FK_OK && masks.first_mask == 0u &&
            masks.second_mask == 0u) {
            track->resting_action = (uint8_t)(action - 1u);
        }
    }
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        track->predicted[axis] = 0.0f; /* like the variances: a snapshot holds them, whether they are valid or not */
    }
    track->covariance[0].predicted_variance = 0.0f;
    track->covariance[1].predicted_variance = 0.0f;
    track->fire_s = ((float)tables->pulse_us + (float)tables->second_delay_us) * 1e-6f;
    fk_track_restart(track);
}

void fk_track_restart(fk_track_t *track)
{
    fk_covariance_init(&track->covariance[0], &fk_noise_position);
    fk_covariance_init(&track->covariance[1], &fk_noise_heading);
    track->learned = 0u;
    track->prediction_valid = 0u;
    track->count = 0u;
}

void fk_track_learn(fk_track_t *track, uint8_t learn)
{
    if (learn == FK_LEARN_OFF && track->wear.learn != FK_LEARN_OFF) {
        fk_wear_init(&track->wear, track->tables, learn);
        track->prediction_valid = 0u; /* the period under way was predicted with what is forgotten */
    } else if (learn == FK_LEARN_HELD) {
        fk_wear_restart(&track->wear);
    }
    track->wear.learn = learn;
}

void fk_track_forget(fk_track_t *track) { track->count = 0u; }

/* A speed that the table can look up: NaN has no code. A track that holds NaN refuses every fix, and so is reset
 * by the third. */
static float speed_or_rest(float speed)
{
    return (speed >= -FK_SPEED_MOST && speed <= FK_SPEED_MOST) ? speed : 0.0f;
}

/* What the table predicts: the motion from instant `from` to the next in the body frame, and the velocity there. */
static void look_up(fk_track_t *track, uint32_t from, float heading_rad, float period_s, fk_motion_t *motion,
                      float *velocity)
{
    const fk_tables_t *tables = track->tables;
    const uint32_t now = 2u * from;
    fk_dynamics_t state;
    fk_dynamics_t next;
    fk_velocity_to_body(heading_rad, track->mean[0][now + 1u], track->mean[1][now + 1u], &velocity[0],
                        &velocity[1]);
    velocity[2] = track->mean[2][now + 1u];
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        velocity[axis] = speed_or_rest(velocity[axis]);
    }
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        state.limb_use[limb] = track->limb_use[from][limb];
        next.limb_use[limb] = state.limb_use[limb];
    }
    if (track->action[from] < tables->actions) {
        fk_lookup_t lookup;
        for (uint32_t axis = 0u; axis < 3u; ++axis) {
            state.velocity_code[axis] = fk_velocity_code(velocity[axis], tables->codes_per_velocity[axis]);
        }
        fk_lookup(tables, &state, &lookup);
        fk_lookup_motion(tables, &lookup, &state, track->action[from], motion);
        fk_lookup_next(tables, &lookup, &state, track->action[from], &next);
        for (uint32_t axis = 0u; axis < 3u; ++axis) {
            velocity[axis] = (float)next.velocity_code[axis] * tables->velocity_scale[axis];
        }
    } else {
        /* The table has no resting action: the velocity is assumed constant. */
        motion->forward_m = velocity[0] * period_s;
        motion->left_m = velocity[1] * period_s;
        motion->turn_rad = velocity[2] * period_s;
    }
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        track->limb_use[from + 1u][limb] = next.limb_use[limb];
    }
}

static void predict(fk_track_t *track, uint32_t from)
{
    const uint32_t now = 2u * from;
    const uint32_t then = now + 2u;
    const float period_s = seconds(track->time_us[from], track->time_us[from + 1u]);
    const float heading_rad = fk_wrap_angle(track->mean[2][now]);
    fk_motion_t motion;
    float velocity[3]; /* body frame at the end */
    float sine;
    float cosine;
    look_up(track, from, heading_rad, period_s, &motion, velocity);
    fk_sincos(heading_rad, &sine, &cosine);
    track->mean[0][then] = track->mean[0][now] + (cosine * motion.forward_m - sine * motion.left_m);
    track->mean[1][then] = track->mean[1][now] + (sine * motion.forward_m + cosine * motion.left_m);
    track->mean[2][then] = track->mean[2][now] + motion.turn_rad;
    fk_sincos(heading_rad + motion.turn_rad, &sine, &cosine);
    track->mean[0][then + 1u] = cosine * velocity[0] - sine * velocity[1];
    track->mean[1][then + 1u] = sine * velocity[0] + cosine * velocity[1];
    track->mean[2][then + 1u] = velocity[2];
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        track->predicted[axis] = track->mean[axis][then];
    }
    const int32_t resting = (track->action[from] == track->resting_action) ? 1 : 0;
    fk_covariance_predict(&track->covariance[0], from, period_s, resting);
    fk_covariance_predict(&track->covariance[1], from, period_s, resting);
}

static void drop_oldest(fk_track_t *track)
{
    --track->count;
    for (uint32_t i = 0u; i < track->count; ++i) {
        track->time_us[i] = track->time_us[i + 1u];
        track->action[i] = track->action[i + 1u];
        track->coasted[i] = track->coasted[i + 1u];
        track->fixes[i] = track->fixes[i + 1u];
        for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
            track->limb_use[i][limb] = track->limb_use[i + 1u][limb];
        }
    }
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        for (uint32_t i = 0u; i < 2u * track->count; ++i) {
            track->mean[axis][i] = track->mean[axis][i + 2u];
        }
    }
    fk_covariance_marginalise(&track->covariance[0], track->count);
    fk_covariance_marginalise(&track->covariance[1], track->count);
}

/* A period begins at the newest instant. */
static void open_period(fk_track_t *track, uint8_t action, uint8_t coasted)
{
    if (track->count == FK_INSTANTS) {
        drop_oldest(track);
    }
    const uint32_t newest = track->count - 1u;
    /* The heading stays within a turn of zero for as long as the robot lives: angles far out have no sine. */
    const float turns_rad = track->mean[2][2u * newest] - fk_wrap_angle(track->mean[2][2u * newest]);
    for (uint32_t i = 0u; i <= newest; ++i) {
        track->mean[2][2u * i] -= turns_rad;
    }
    track->action[newest] = action;
    track->coasted[newest] = coasted;
    track->fixes[newest] = 0u;
    track->time_us[newest + 1u] = track->time_us[newest] + track->tables->period_us;
    track->prediction_valid = 1u;
    ++track->count;
    predict(track, newest);
}

/* Instant 0 gets this pose, with the variance of an unknown one, and zero speed. */
static void put_first(fk_track_t *track, const float *pose)
{
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        track->mean[axis][0] = pose[axis];
        track->mean[axis][1] = 0.0f;
    }
    fk_covariance_reset(&track->covariance[0]);
    fk_covariance_reset(&track->covariance[1]);
}

static void begin_with(fk_track_t *track, uint64_t at_us, uint8_t action, uint8_t coasted)
{
    static const float origin[3] = {0.0f, 0.0f, 0.0f};
    track->count = 1u;
    track->time_us[0] = at_us;
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        track->limb_use[0][limb] = 0u;
    }
    put_first(track, origin);
    open_period(track, action, coasted);
    track->prediction_valid = 0u;
}

void fk_track_begin(fk_track_t *track, uint64_t at_us) { begin_with(track, at_us, track->resting_action, 1u); }

void fk_track_coast(fk_track_t *track, uint64_t at_us)
{
    for (uint32_t coasts = 0u; track->count > 0u && at_us > track->time_us[track->count - 1u] + FK_COAST_US; ++coasts) {
        if (coasts == FK_TRACK_COASTS_MAX) {
            fk_track_forget(track);
        } else {
            open_period(track, track->resting_action, 1u);
        }
    }
}

/* The period that holds at_us, or the last one; returns the instant that it begins at. */
static uint32_t profile_at(const fk_track_t *track, uint64_t at_us, fk_profile_t *profile)
{
    uint32_t from = track->count - 2u;
    if (at_us >= track->time_us[from + 1u]) {
        fk_profile_after(seconds(track->time_us[from + 1u], at_us), profile);
        return from;
    }
    while (from > 0u && at_us < track->time_us[from]) {
        --from;
    }
    fk_profile_within(seconds(track->time_us[from], at_us),
                      seconds(track->time_us[from], track->time_us[from + 1u]), track->fire_s, profile);
    return from;
}

void fk_track_state(const fk_track_t *track, uint64_t at_us, float *pose, float *speed)
{
    fk_profile_t profile;
    const uint32_t from = profile_at(track, at_us, &profile);
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        pose[axis] = fk_profile_sum(profile.pose, track->mean[axis] + 2u * from);
        speed[axis] = fk_profile_sum(profile.speed, track->mean[axis] + 2u * from);
    }
}

int32_t fk_track_update(fk_track_t *track, uint64_t at_us, const float *pose, int32_t gated)
{
    fk_profile_t profile;
    fk_innovation_t innovation[2];
    float difference[3];
    const uint32_t states = 2u * track->count;
    const uint32_t from = profile_at(track, at_us, &profile);
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        difference[axis] = pose[axis] - fk_profile_sum(profile.pose, track->mean[axis] + 2u * from);
    }
    difference[2] = fk_wrap_angle(difference[2]);
    float position_gate =
        fk_covariance_innovation(&track->covariance[0], &profile, from, states, track->fixes[from], &innovation[0]);
    float heading_gate =
        fk_covariance_innovation(&track->covariance[1], &profile, from, states, track->fixes[from], &innovation[1]);
    if (gated == 0) {
        position_gate = FK_GATE_OPEN;
        heading_gate = FK_GATE_OPEN;
    }
    /* Comparisons with NaN are false, so this refuses it too. */
    const float square_m2 = difference[0] * difference[0] + difference[1] * difference[1];
    if (!(square_m2 <= position_gate) || !(difference[2] * difference[2] <= heading_gate)) {
        return 0;
    }
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        const fk_innovation_t *one = &innovation[covariance_of[axis]];
        const float step = difference[axis] / one->variance;
        for (uint32_t i = 0u; i < states; ++i) {
            track->mean[axis][i] += one->cross[i] * step;
        }
    }
    fk_covariance_update(&track->covariance[0], &innovation[0], states);
    fk_covariance_update(&track->covariance[1], &innovation[1], states);
    if (track->fixes[from] < UINT8_MAX) {
        ++track->fixes[from];
    }
    return 1;
}

void fk_track_reset_pose(fk_track_t *track, uint64_t at_us, const float *pose)
{
    fk_profile_t profile;
    for (uint32_t i = profile_at(track, at_us, &profile); i > 0u; --i) {
        drop_oldest(track);
    }
    put_first(track, pose);
    for (uint32_t i = 0u; i + 1u < track->count; ++i) {
        track->fixes[i] = 0u;
        predict(track, i);
    }
    track->prediction_valid = 0u;
    /* The pose is the one at at_us, not the one at instant 0: all of them move. */
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        const float difference = pose[axis] - fk_profile_sum(profile.pose, track->mean[axis]);
        for (uint32_t i = 0u; i < track->count; ++i) {
            track->mean[axis][2u * i] += difference;
        }
    }
    (void)fk_track_update(track, at_us, pose, 0);
}

/* Adapt the process noise and the estimate of wear by the prediction error of the period that ends. */
static void learn(fk_track_t *track)
{
    const uint32_t newest = track->count - 1u;
    fk_wear_period_t period;
    float square[3];
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        const float difference = track->mean[axis][2u * newest] - track->predicted[axis];
        period.error[axis] = difference;
        square[axis] = difference * difference;
    }
    period.variance[0] = fk_covariance_informed(&track->covariance[0], newest);
    period.variance[1] = fk_covariance_informed(&track->covariance[1], newest);
    if (period.variance[0] >= 0.0f && period.variance[1] >= 0.0f) {
        period.heading_rad = fk_wrap_angle(track->mean[2][2u * newest - 2u]);
        period.period_s = seconds(track->time_us[newest - 1u], track->time_us[newest]);
        period.action = track->action[newest - 1u];
        fk_wear_learn(&track->wear, track->tables, &period);
    }
    const float part = learn_parts[track->learned];
    fk_covariance_adapt(&track->covariance[0], newest, square[0] + square[1], 2.0f, part);
    fk_covariance_adapt(&track->covariance[1], newest, square[2], 1.0f, part);
    if (track->learned < 3u) {
        ++track->learned;
    }
}

/* Move the newest instant to another time after the one before it. */
static void move_newest(fk_track_t *track, uint64_t at_us)
{
    fk_profile_t profile;
    const uint32_t newest = track->count - 1u;
    (void)profile_at(track, at_us, &profile);
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        float *mean = track->mean[axis] + 2u * newest;
        const float pose = fk_profile_sum(profile.pose, mean - 2);
        mean[1] = fk_profile_sum(profile.speed, mean - 2);
        mean[0] = pose;
    }
    fk_covariance_retime(&track->covariance[0], &profile, newest);
    fk_covariance_retime(&track->covariance[1], &profile, newest);
    track->time_us[newest] = at_us;
}

void fk_track_end_period(fk_track_t *track, uint64_t at_us)
{
    const uint32_t latest = track->count - 2u;
    if (track->prediction_valid != 0u && track->coasted[latest] == 0u &&
        at_us >= track->time_us[latest] + FK_PERIOD_LEAST_US) {
        learn(track);
        track->prediction_valid = 0u; /* once for each period */
    }
}

/* Whether the current period was taken as rest only because the action that begins at at_us was not known yet. */
static int32_t coasted_too_soon(const fk_track_t *track, uint64_t at_us)
{
    const uint32_t latest = track->count - 2u;
    return track->coasted[latest] != 0u && at_us < track->time_us[latest] + FK_COAST_US;
}

const uint16_t *fk_track_limb_use(const fk_track_t *track, uint64_t at_us)
{
    return track->limb_use[coasted_too_soon(track, at_us) ? track->count - 2u : track->count - 1u];
}

void fk_track_act(fk_track_t *track, uint64_t at_us, uint8_t action)
{
    if (track->count == 0u) {
        begin_with(track, at_us, action, 0u);
        return;
    }
    uint32_t latest = track->count - 2u; /* begins the current period */
    if (latest > 0u && coasted_too_soon(track, at_us)) {
        --track->count;
        --latest;
        track->prediction_valid = 0u;
    }
    if (at_us < track->time_us[latest] + FK_PERIOD_LEAST_US) {
        --track->count;
    } else {
        fk_track_end_period(track, at_us);
        if (at_us != track->time_us[latest + 1u]) {
            move_newest(track, at_us);
        }
    }
    open_period(track, action, 0u);
}
