/* Tests only: loops over the core's functions, so that Python need not make a call for each case. */
#include "fk_robot_state.h"

typedef struct {
    fk_tables_t tables;
    fk_estimator_t estimator;
} fk_test_estimator_t;

uint32_t fk_test_encoded_max(void);
int32_t fk_test_decode(const uint8_t *encoded, uint32_t length, uint8_t *head, uint8_t *payload,
                       uint32_t *payload_length);
uint32_t fk_test_count_frames(const uint8_t *bytes, const uint32_t *lengths, uint32_t count);
int32_t fk_test_on_frames(fk_robot_t *robot, const uint8_t *bytes, const uint32_t *lengths, uint32_t count,
                          uint64_t now_us);
void fk_test_hmac(const uint8_t *key, const uint8_t *bytes, const uint32_t *lengths, uint32_t count, uint8_t *code);
uint32_t fk_test_collect(const uint8_t *bytes, uint32_t length, uint8_t *frames, uint32_t *lengths);
int32_t fk_test_estimator_init(fk_test_estimator_t *test, const uint8_t *image, uint32_t bytes);
int32_t fk_test_estimator_add(fk_test_estimator_t *test, uint64_t capture_us, const float *pose, uint16_t sequence);
void fk_test_estimator_act(fk_test_estimator_t *test, uint64_t at_us, uint8_t action);
int32_t fk_test_estimator_at(fk_test_estimator_t *test, uint64_t at_us, float *state, uint32_t *numbers);
void fk_test_estimator_end_period(fk_test_estimator_t *test, uint64_t at_us);
void fk_test_estimator_learn(fk_test_estimator_t *test, uint8_t learn);
uint32_t fk_test_estimator_inside(fk_test_estimator_t *test, float *values, uint32_t *counts);
void fk_test_estimator_spoil(fk_test_estimator_t *test, uint32_t speed, float value);
void fk_test_rule(uint8_t state, uint8_t event, uint8_t *rule);
void fk_test_spoil_robot(fk_robot_t *robot, int32_t state, int32_t action);
void fk_test_spoil_guard(fk_robot_t *robot, uint32_t bit);
void fk_test_floats(const uint32_t *bits, uint32_t count, uint8_t *bytes, uint32_t *back);

uint32_t fk_test_encoded_max(void) { return FK_FRAME_ENCODED_MAX; }

int32_t fk_test_decode(const uint8_t *encoded, uint32_t length, uint8_t *head, uint8_t *payload,
                       uint32_t *payload_length)
{
    fk_frame_t frame;
    int32_t error = fk_frame_decode(encoded, length, &frame);
    if (error == 0) {
        head[0] = frame.type;
        head[1] = frame.sequence;
        *payload_length = frame.payload_length;
        for (uint32_t i = 0u; i < frame.payload_length; ++i) {
            payload[i] = frame.payload[i];
        }
    }
    return error;
}

/* How many of these strings are frames. */
uint32_t fk_test_count_frames(const uint8_t *bytes, const uint32_t *lengths, uint32_t count)
{
    uint32_t good = 0u;
    fk_frame_t frame;
    for (uint32_t i = 0u; i < count; ++i) {
        good += (fk_frame_decode(bytes, lengths[i], &frame) == 0) ? 1u : 0u;
        bytes += lengths[i];
    }
    return good;
}

/* Give the robot these strings; 1 where anything but the count of bad frames changed. */
int32_t fk_test_on_frames(fk_robot_t *robot, const uint8_t *bytes, const uint32_t *lengths, uint32_t count,
                          uint64_t now_us)
{
    fk_robot_t before = *robot;
    const uint8_t *a = (const uint8_t *)&before;
    const uint8_t *b = (const uint8_t *)robot;
    for (uint32_t i = 0u; i < count; ++i) {
        fk_robot_on_frame(robot, bytes, lengths[i], now_us);
        bytes += lengths[i];
    }
    before.frames_bad += count;
    for (uint32_t i = 0u; i < sizeof(fk_robot_t); ++i) {
        if (a[i] != b[i]) {
            return 1;
        }
    }
    return 0;
}

/* The authentication code of strings, one behind the other. */
void fk_test_hmac(const uint8_t *key, const uint8_t *bytes, const uint32_t *lengths, uint32_t count, uint8_t *code)
{
    fk_hmac_t hmac;
    fk_hmac_begin(&hmac, key);
    for (uint32_t i = 0u; i < count; ++i) {
        fk_hmac_add(&hmac, bytes, lengths[i]);
        bytes += lengths[i];
    }
    fk_hmac_end(&hmac, code);
}

/* Feed a stream to a collector: frames one after the other, and the length of each. */
uint32_t fk_test_collect(const uint8_t *bytes, uint32_t length, uint8_t *frames, uint32_t *lengths)
{
    fk_frame_collector_t collector;
    uint32_t count = 0u;
    collector.length = 0u;
    for (uint32_t i = 0u; i < length; ++i) {
        uint32_t found = fk_frame_collect(&collector, bytes[i]);
        if (found > 0u) {
            for (uint32_t k = 0u; k < found; ++k) {
                *frames = collector.bytes[k];
                ++frames;
            }
            lengths[count] = found;
            ++count;
        }
    }
    return count;
}

/* tables: the opened one of a test; the estimator keeps a pointer to it. */
int32_t fk_test_estimator_init(fk_test_estimator_t *test, const uint8_t *image, uint32_t bytes)
{
    int32_t error = fk_tables_open(image, bytes, &test->tables);
    if (error == 0) {
        fk_estimator_init(&test->estimator, &test->tables, FK_LEARN_OFF);
    }
    return error;
}

int32_t fk_test_estimator_add(fk_test_estimator_t *test, uint64_t capture_us, const float *pose, uint16_t sequence)
{
    fk_fix_t fix = {capture_us, {pose[0], pose[1], pose[2]}, sequence};
    return fk_estimator_add(&test->estimator, &fix);
}

void fk_test_estimator_act(fk_test_estimator_t *test, uint64_t at_us, uint8_t action)
{
    fk_estimator_act(&test->estimator, at_us, action);
}

int32_t fk_test_estimator_at(fk_test_estimator_t *test, uint64_t at_us, float *state, uint32_t *numbers)
{
    fk_estimate_t estimate;
    int32_t error = fk_estimator_at(&test->estimator, at_us, &estimate);
    if (error == 0) {
        state[0] = estimate.state.x_m;
        state[1] = estimate.state.y_m;
        state[2] = estimate.state.heading_rad;
        state[3] = estimate.state.vx_mps;
        state[4] = estimate.state.vy_mps;
        state[5] = estimate.state.omega_rad_s;
        numbers[0] = estimate.fix_sequence;
        numbers[1] = estimate.fixes;
        for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
            numbers[2u + limb] = estimate.state.limb_use[limb];
        }
    }
    return error;
}

/* As a decision does that has an estimate. */
void fk_test_estimator_end_period(fk_test_estimator_t *test, uint64_t at_us)
{
    fk_estimate_t estimate;
    if (fk_estimator_at(&test->estimator, at_us, &estimate) == 0) {
        fk_track_end_period(&test->estimator.track, at_us);
    }
}

void fk_test_estimator_learn(fk_test_estimator_t *test, uint8_t learn)
{
    fk_estimator_learn(&test->estimator, learn);
}

/* All that the track believes: means, covariances, process noise, what was learned of the limbs; and what the estimator counts. Returns the floats written. */
uint32_t fk_test_estimator_inside(fk_test_estimator_t *test, float *values, uint32_t *counts)
{
    fk_estimate_t none;
    (void)fk_estimator_at(&test->estimator, UINT64_MAX / 2u, &none); /* an action that waits is predicted */
    const fk_track_t *track = &test->estimator.track;
    uint32_t at = 0u;
    for (uint32_t axis = 0u; axis < 3u; ++axis) {
        for (uint32_t i = 0u; i < 2u * track->count; ++i) {
            values[at++] = track->mean[axis][i];
        }
    }
    for (uint32_t k = 0u; k < 2u; ++k) {
        for (uint32_t i = 0u; i < 2u * track->count; ++i) {
            for (uint32_t j = 0u; j < 2u * track->count; ++j) {
                values[at++] = track->covariance[k].matrix[i][j];
            }
        }
    }
    values[at++] = track->covariance[0].process_noise;
    values[at++] = track->covariance[1].process_noise;
    if (track->wear.learn != FK_LEARN_OFF) {
        const uint32_t unknowns = 3u + track->tables->limbs;
        for (uint32_t i = 0u; i < unknowns * (unknowns + 1u) / 2u; ++i) {
            values[at++] = track->wear.information[i];
        }
        for (uint32_t i = 0u; i < unknowns; ++i) {
            values[at++] = track->wear.vector[i];
        }
        for (uint32_t i = 0u; i < 3u; ++i) {
            values[at++] = track->wear.current[i];
        }
        for (uint32_t limb = 0u; limb < track->tables->limbs; ++limb) {
            values[at++] = (float)track->wear.lost[limb];
        }
    }
    counts[0] = track->count;
    counts[1] = test->estimator.fixes;
    counts[2] = test->estimator.restarts;
    return at;
}

/* The newest instant's pose or speed, x. */
void fk_test_estimator_spoil(fk_test_estimator_t *test, uint32_t speed, float value)
{
    test->estimator.track.mean[0][2u * (test->estimator.track.count - 1u) + speed] = value;
}

/* One cell of the supervisor's table, as bytes. */
void fk_test_rule(uint8_t state, uint8_t event, uint8_t *rule)
{
    fk_rule_t found = fk_supervisor_rule(state, event);
    rule[0] = found.next;
    rule[1] = found.action;
    rule[2] = (uint8_t)found.status;
}

/* What damaged memory may hold: another state, another action asked for; negative: as it is. */
void fk_test_spoil_robot(fk_robot_t *robot, int32_t state, int32_t action)
{
    robot->state = (state < 0) ? robot->state : (uint8_t)state;
    robot->stroke_request = (action < 0) ? robot->stroke_request : (uint8_t)(action + 1);
}

void fk_test_spoil_guard(fk_robot_t *robot, uint32_t bit)
{
    ((uint8_t *)&robot->guard)[bit / 8u] ^= (uint8_t)(1u << bit % 8u);
}

/* Numbers through fk_put_f32 and fk_get_f32: their bytes and what comes back, as bits. */
void fk_test_floats(const uint32_t *bits, uint32_t count, uint8_t *bytes, uint32_t *back)
{
    for (uint32_t i = 0u; i < count; ++i) {
        fk_f32_bits_t pun;
        pun.bits = bits[i];
        fk_put_f32(bytes + 4u * i, pun.value);
        pun.value = fk_get_f32(bytes + 4u * i);
        back[i] = pun.bits;
    }
}
