/* Tests only: loops over the core's functions, so that Python need not make a call for each case. */
#include "fk_robot.h"

uint32_t fk_test_guard_bytes(void);
uint32_t fk_test_estimator_bytes(void);
uint32_t fk_test_encoded_max(void);
int32_t fk_test_decode(const uint8_t *encoded, uint32_t length, uint8_t *head, uint8_t *payload,
                       uint32_t *payload_length);
uint32_t fk_test_count_frames(const uint8_t *bytes, const uint32_t *lengths, uint32_t count);
int32_t fk_test_on_frames(fk_robot_t *robot, const uint8_t *bytes, const uint32_t *lengths, uint32_t count,
                          uint64_t now_us);
uint32_t fk_test_collect(const uint8_t *bytes, uint32_t length, uint8_t *frames, uint32_t *lengths);
int32_t fk_test_estimator_add(void *estimator, uint64_t capture_us, const float *pose, uint16_t sequence);
int32_t fk_test_estimator_at(const void *estimator, uint64_t at_us, float *state, uint32_t *numbers);
void fk_test_floats(const uint32_t *bits, uint32_t count, uint8_t *bytes, uint32_t *back);

uint32_t fk_test_guard_bytes(void) { return (uint32_t)sizeof(fk_guard_t); }

uint32_t fk_test_estimator_bytes(void) { return (uint32_t)sizeof(fk_estimator_t); }

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

int32_t fk_test_estimator_add(void *estimator, uint64_t capture_us, const float *pose, uint16_t sequence)
{
    fk_fix_t fix = {capture_us, pose[0], pose[1], pose[2], sequence};
    return fk_estimator_add((fk_estimator_t *)estimator, &fix);
}

int32_t fk_test_estimator_at(const void *estimator, uint64_t at_us, float *state, uint32_t *numbers)
{
    fk_estimate_t estimate;
    int32_t error = fk_estimator_at((const fk_estimator_t *)estimator, at_us, &estimate);
    if (error == 0) {
        state[0] = estimate.state.x_m;
        state[1] = estimate.state.y_m;
        state[2] = estimate.state.heading_rad;
        state[3] = estimate.state.vx_mps;
        state[4] = estimate.state.vy_mps;
        state[5] = estimate.state.omega_rad_s;
        numbers[0] = estimate.fix_sequence;
        numbers[1] = estimate.fixes;
    }
    return error;
}

/* Numbers through fk_put_f32 and fk_get_f32: their bytes and what comes back, as bits. */
void fk_test_floats(const uint32_t *bits, uint32_t count, uint8_t *bytes, uint32_t *back)
{
    for (uint32_t i = 0u; i < count; ++i) {
        fk_float_bits_t pun;
        pun.bits = bits[i];
        fk_put_f32(bytes + 4u * i, pun.value);
        pun.value = fk_get_f32(bytes + 4u * i);
        back[i] = pun.bits;
    }
}
