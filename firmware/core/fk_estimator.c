#include "fk_estimator.h"

#include "fk_frames_layout.h"

void fk_estimator_init(fk_estimator_t *estimator) { estimator->count = 0u; }

/* Comparisons with NaN are false, so this refuses it too. */
static int32_t within(float value, float limit) { return value >= -limit && value <= limit; }

int32_t fk_estimator_add(fk_estimator_t *estimator, const fk_fix_t *fix)
{
    if (!within(fix->x_m, FK_FIX_FIELD_M) || !within(fix->y_m, FK_FIX_FIELD_M) ||
        !within(fix->heading_rad, FK_FIX_FIELD_M)) {
        return FK_STATUS_RANGE;
    }
    if (estimator->count > 0u && fix->capture_us <= estimator->fixes[estimator->count - 1u].capture_us) {
        return FK_STATUS_RANGE;
    }
    if (estimator->count == FK_FIXES_MAX) {
        for (uint32_t i = 1u; i < FK_FIXES_MAX; ++i) {
            estimator->fixes[i - 1u] = estimator->fixes[i];
        }
        --estimator->count;
    }
    estimator->fixes[estimator->count] = *fix;
    estimator->fixes[estimator->count].heading_rad = fk_wrap_angle(fix->heading_rad);
    ++estimator->count;
    return FK_STATUS_OK;
}

int32_t fk_estimator_at(const fk_estimator_t *estimator, uint64_t at_us, fk_estimate_t *estimate)
{
    if (estimator->count == 0u) {
        return FK_STATUS_STALE;
    }
    const fk_fix_t *newest = &estimator->fixes[estimator->count - 1u];
    int64_t lead_us = (int64_t)(at_us - newest->capture_us);
    if (lead_us > FK_FIX_STALE_US || lead_us < -FK_FIX_FUTURE_US) {
        return FK_STATUS_STALE;
    }

    /* Everything relative to the newest fix: small numbers keep float32 exact enough. */
    float t_s[FK_FIXES_MAX];
    float dx_m[FK_FIXES_MAX];
    float dy_m[FK_FIXES_MAX];
    float dh_rad[FK_FIXES_MAX];
    uint32_t used = 0u;
    for (uint32_t i = 0u; i < estimator->count; ++i) {
        const fk_fix_t *fix = &estimator->fixes[i];
        uint64_t age_us = newest->capture_us - fix->capture_us;
        if (age_us <= FK_FIX_WINDOW_US) {
            t_s[used] = (float)(-(int32_t)age_us) * 1e-6f;
            dx_m[used] = fix->x_m - newest->x_m;
            dy_m[used] = fix->y_m - newest->y_m;
            dh_rad[used] = fk_wrap_angle(fix->heading_rad - newest->heading_rad);
            ++used;
        }
    }
    float t_sum = 0.0f;
    float x_sum = 0.0f;
    float y_sum = 0.0f;
    float h_sum = 0.0f;
    for (uint32_t i = 0u; i < used; ++i) {
        t_sum += t_s[i];
        x_sum += dx_m[i];
        y_sum += dy_m[i];
        h_sum += dh_rad[i];
    }
    float number = (float)used;
    float t_mean = t_sum / number;
    float x_mean = x_sum / number;
    float y_mean = y_sum / number;
    float h_mean = h_sum / number;
    float tt = 0.0f;
    float tx = 0.0f;
    float ty = 0.0f;
    float th = 0.0f;
    for (uint32_t i = 0u; i < used; ++i) {
        float dt = t_s[i] - t_mean;
        tt += dt * dt;
        tx += dt * (dx_m[i] - x_mean);
        ty += dt * (dy_m[i] - y_mean);
        th += dt * (dh_rad[i] - h_mean);
    }
    float vx_mps = 0.0f;
    float vy_mps = 0.0f;
    float omega_rad_s = 0.0f;
    if (tt > 0.0f) {
        vx_mps = tx / tt;
        vy_mps = ty / tt;
        omega_rad_s = th / tt;
    }
    float lead_s = (float)(int32_t)lead_us * 1e-6f - t_mean;
    estimate->state.x_m = newest->x_m + (x_mean + vx_mps * lead_s);
    estimate->state.y_m = newest->y_m + (y_mean + vy_mps * lead_s);
    estimate->state.heading_rad = fk_wrap_angle(newest->heading_rad + (h_mean + omega_rad_s * lead_s));
    fk_velocity_to_body(estimate->state.heading_rad, vx_mps, vy_mps, &estimate->state.vx_mps, &estimate->state.vy_mps);
    estimate->state.omega_rad_s = omega_rad_s;
    estimate->fix_sequence = newest->sequence;
    estimate->fixes = (uint8_t)used;
    return FK_STATUS_OK;
}
