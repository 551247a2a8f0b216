#include "fk_estimator.h"

#include "fk_frames_layout.h"

void fk_estimator_init(fk_estimator_t *estimator, fk_tables_t *tables, uint8_t learn)
{
    fk_track_init(&estimator->track, tables, learn);
    estimator->restarts = 0u;
    fk_estimator_restart(estimator);
}

void fk_estimator_restart(fk_estimator_t *estimator)
{
    fk_track_restart(&estimator->track);
    for (uint32_t i = 0u; i < FK_FIX_MARKS; ++i) {
        estimator->marks[i] = 0u;
    }
    estimator->next_mark = 0u;
    estimator->outlier_count = 0u;
    estimator->newest_us = 0u;
    estimator->newest_sequence = 0u;
    estimator->fixes = 0u;
    estimator->action_waits = 0u;
    estimator->action = 0u;
    estimator->action_us = 0u;
}

/* Comparisons with NaN are false, so this refuses it too. */
static int32_t within(float value, float limit) { return value >= -limit && value <= limit; }

/* The hash of a fix in the duplicate filter, never 0: FNV-1a over its sequence number and the bits of its pose.
 * The capture time does not count, since the age in a frame that a link delivers twice is wrong the second time. */
static uint32_t mark_of(const fk_fix_t *fix)
{
    uint32_t mark = (2166136261u ^ fix->sequence) * 16777619u;
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        fk_f32_bits_t pun;
        pun.value = fix->pose[axis];
        mark = (mark ^ (pun.bits & 0xFFFFu)) * 16777619u;
        mark = (mark ^ (pun.bits >> 16)) * 16777619u;
    }
    return mark | 1u;
}

static int32_t agree(const fk_fix_t *a, const fk_fix_t *b)
{
    const uint64_t apart_us =
        (a->capture_us > b->capture_us) ? a->capture_us - b->capture_us : b->capture_us - a->capture_us;
    const float apart_s = (float)(uint32_t)apart_us * 1e-6f; /* fits: coast() lets none be compared with one of minutes ago */
    const float dx = a->pose[0] - b->pose[0];
    const float dy = a->pose[1] - b->pose[1];
    const float reach_m = FK_OUTLIERS_AGREE_M + FK_OUTLIERS_AGREE_MPS * apart_s;
    return dx * dx + dy * dy <= reach_m * reach_m &&
           within(fk_wrap_angle(a->pose[2] - b->pose[2]), FK_OUTLIERS_AGREE_RAD + FK_OUTLIERS_AGREE_RAD_S * apart_s);
}

static void accept(fk_estimator_t *estimator, const fk_fix_t *fix)
{
    if (estimator->fixes == 0u || fix->capture_us > estimator->newest_us) {
        estimator->newest_us = fix->capture_us;
        estimator->newest_sequence = fix->sequence;
    }
    if (estimator->fixes < UINT8_MAX) {
        ++estimator->fixes;
    }
}

/* Reset the pose to the outliers, the earliest first, without those from before the oldest instant. */
static void reset_to_outliers(fk_estimator_t *estimator)
{
    fk_track_t *track = &estimator->track;
    uint32_t first = FK_OUTLIERS_MAX;
    for (uint32_t i = 0u; i < estimator->outlier_count; ++i) {
        if (estimator->outliers[i].capture_us >= track->time_us[0] &&
            (first == FK_OUTLIERS_MAX || estimator->outliers[i].capture_us < estimator->outliers[first].capture_us)) {
            first = i;
        }
    }
    fk_track_reset_pose(track, estimator->outliers[first].capture_us, estimator->outliers[first].pose);
    estimator->fixes = 0u;
    accept(estimator, &estimator->outliers[first]);
    for (uint32_t i = 0u; i < estimator->outlier_count; ++i) {
        if (i != first && estimator->outliers[i].capture_us >= track->time_us[0]) {
            (void)fk_track_update(track, estimator->outliers[i].capture_us, estimator->outliers[i].pose, 0);
            accept(estimator, &estimator->outliers[i]);
        }
    }
    estimator->outlier_count = 0u;
}

/* Buffer a fix outside the gate. Returns 1 where it and those before reset the pose, else 0. */
static int32_t note_outlier(fk_estimator_t *estimator, const fk_fix_t *fix)
{
    if (estimator->outlier_count > 0u && !agree(fix, &estimator->outliers[estimator->outlier_count - 1u])) {
        estimator->outlier_count = 0u;
    }
    estimator->outliers[estimator->outlier_count] = *fix;
    ++estimator->outlier_count;
    if (estimator->outlier_count < FK_OUTLIERS_MAX) {
        return 0;
    }
    fk_covariance_inflate(&estimator->track.covariance[0]);
    fk_covariance_inflate(&estimator->track.covariance[1]);
    reset_to_outliers(estimator);
    ++estimator->restarts;
    return 1;
}

/* Bring the track to a time. The state is unknown after too many periods without an action, or too long without a
 * fix. */
static void coast(fk_estimator_t *estimator, uint64_t at_us)
{
    fk_track_coast(&estimator->track, at_us);
    if (estimator->track.count == 0u || fk_estimator_is_lost(estimator, at_us, FK_FIX_UNKNOWN_US)) {
        estimator->fixes = 0u;
    }
}

/* Predict the last action, if that was not done yet. Not in fk_estimator_act(), where a stroke waits to begin. */
static void predict_action(fk_estimator_t *estimator)
{
    if (estimator->action_waits != 0u) {
        estimator->action_waits = 0u;
        coast(estimator, estimator->action_us);
        fk_track_act(&estimator->track, estimator->action_us, estimator->action);
    }
}

int32_t fk_estimator_add(fk_estimator_t *estimator, const fk_fix_t *given)
{
    fk_fix_t fix = *given;
    if (!within(fix.pose[0], FK_FIX_FIELD_M) || !within(fix.pose[1], FK_FIX_FIELD_M) ||
        !within(fix.pose[2], FK_FIX_FIELD_M)) {
        return FK_STATUS_RANGE;
    }
    const uint32_t mark = mark_of(&fix);
    for (uint32_t i = 0u; i < FK_FIX_MARKS; ++i) {
        if (estimator->marks[i] == mark) {
            return FK_STATUS_DOUBLE;
        }
    }
    predict_action(estimator);
    coast(estimator, fix.capture_us);
    if (estimator->track.count == 0u) {
        fk_track_begin(&estimator->track, fix.capture_us);
    }
    if (fix.capture_us < estimator->track.time_us[0]) {
        return FK_STATUS_OLD;
    }
    estimator->marks[estimator->next_mark] = mark;
    estimator->next_mark = (uint8_t)((estimator->next_mark + 1u) % FK_FIX_MARKS);
    fix.pose[2] = fk_wrap_angle(fix.pose[2]);
    if (estimator->fixes == 0u) {
        estimator->outliers[0] = fix;
        estimator->outlier_count = 1u;
        reset_to_outliers(estimator);
    } else if (fk_track_update(&estimator->track, fix.capture_us, fix.pose, 1) != 0) {
        accept(estimator, &fix);
        estimator->outlier_count = 0u;
    } else if (!note_outlier(estimator, &fix)) {
        return FK_STATUS_OUTLIER;
    }
    return FK_STATUS_OK;
}

int32_t fk_estimator_at(fk_estimator_t *estimator, uint64_t at_us, fk_estimate_t *estimate)
{
    predict_action(estimator);
    const int64_t lead_us = (int64_t)(at_us - estimator->newest_us);
    if (estimator->fixes == 0u || lead_us > FK_FIX_STALE_US || lead_us < -FK_FIX_FUTURE_US) {
        return FK_STATUS_STALE;
    }
    coast(estimator, at_us);
    const fk_track_t *track = &estimator->track;
    if (estimator->fixes == 0u || at_us < track->time_us[0]) {
        return FK_STATUS_STALE;
    }
    float pose[3];
    float speed[3];
    fk_track_state(track, at_us, pose, speed);
    fk_state_t *state = &estimate->state;
    state->x_m = pose[0];
    state->y_m = pose[1];
    state->heading_rad = fk_wrap_angle(pose[2]);
    fk_velocity_to_body(state->heading_rad, speed[0], speed[1], &state->vx_mps, &state->vy_mps);
    state->omega_rad_s = speed[2];
    const uint16_t *limb_use = fk_track_limb_use(track, at_us);
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        state->limb_use[limb] = limb_use[limb];
    }
    estimate->fix_sequence = estimator->newest_sequence;
    estimate->fixes = estimator->fixes;
    return FK_STATUS_OK;
}

void fk_estimator_act(fk_estimator_t *estimator, uint64_t at_us, uint8_t action)
{
    predict_action(estimator);
    estimator->action_us = at_us;
    estimator->action = action;
    estimator->action_waits = 1u;
}

void fk_estimator_learn(fk_estimator_t *estimator, uint8_t learn)
{
    predict_action(estimator); /* the period that ends with that action is still learned from in the old mode */
    fk_track_learn(&estimator->track, learn);
}

int32_t fk_estimator_is_lost(const fk_estimator_t *estimator, uint64_t at_us, uint64_t age_us)
{
    if (estimator->fixes == 0u) {
        return 1;
    }
    return at_us > estimator->newest_us && at_us - estimator->newest_us > age_us;
}
