/* math.c - angles in float32 with + - * only, one defined order of operations, no libm. */
#include "fk_trig.h"

/* Adding 1.5 * 2^23 and taking it away again rounds |value| < 2^22 to the nearest integer (ties to even). */
#define FK_ROUND_SHIFT 12582912.0f

/* 2 pi = TURN_1 + TURN_2 + TURN_3 to within 2e-15. TURN_1 = 201 / 32 has 8 significant bits, TURN_2 12:
 * times a turn count of at most 335 (9 bits, FK_ANGLE_MAX_RAD / 2 pi) both products are exact. */
#define FK_TURN_1_RAD 6.28125f
#define FK_TURN_2_RAD 0.00193548203f
#define FK_TURN_3_RAD (-1.74845553e-07f)
#define FK_TURNS_PER_RAD 0.159154937f

/* pi / 2 likewise; quarter turns are at most 1337 (11 bits), so k * 8 bits and k * 12 bits are exact. */
#define FK_QUARTER_1_RAD 1.5703125f
#define FK_QUARTER_2_RAD 0.000483870506f
#define FK_QUARTER_3_RAD (-4.37113883e-08f)
#define FK_QUARTERS_PER_RAD 0.636619747f

int32_t fk_float_is_not_finite(float value)
{
    return (fk_bits_of_float(value) & FK_FLOAT_MAGNITUDE) >= FK_FLOAT_INFINITY ? 1 : 0;
}

/* Whether an angle is beyond the range reduction; true for NaN and infinity as well. */
static int32_t fk_angle_is_beyond(float angle_rad)
{
    return (fk_bits_of_float(angle_rad) & FK_FLOAT_MAGNITUDE) > fk_bits_of_float(FK_ANGLE_MAX_RAD) ? 1 : 0;
}

float fk_wrap_angle(float angle_rad)
{
    float turns;
    float wrapped;

    if (fk_angle_is_beyond(angle_rad) != 0) {
        return fk_float_of_bits(FK_FLOAT_NAN);
    }
    if ((angle_rad > -FK_PI) && (angle_rad <= FK_PI)) {
        return angle_rad;
    }
    turns = (angle_rad * FK_TURNS_PER_RAD + FK_ROUND_SHIFT) - FK_ROUND_SHIFT;
    wrapped = ((angle_rad - turns * FK_TURN_1_RAD) - turns * FK_TURN_2_RAD) - turns * FK_TURN_3_RAD;
    /* The quotient's rounding may choose the turn next to the right one within 1e-4 rad of half a turn. */
    if (wrapped > FK_PI) {
        wrapped = ((wrapped - FK_TURN_1_RAD) - FK_TURN_2_RAD) - FK_TURN_3_RAD;
    }
    if (wrapped <= -FK_PI) {
        wrapped = ((wrapped + FK_TURN_1_RAD) + FK_TURN_2_RAD) + FK_TURN_3_RAD;
    }
    return wrapped; /* no float32 is left beyond half a turn: tests/codegen tries them all */
}

void fk_sincos(float angle_rad, float *sine, float *cosine)
{
    float quarters;
    float rest;
    float sine_rest;
    float cosine_rest;
    uint32_t quadrant;

    if (fk_angle_is_beyond(angle_rad) != 0) {
        *sine = fk_float_of_bits(FK_FLOAT_NAN);
        *cosine = fk_float_of_bits(FK_FLOAT_NAN);
        return;
    }
    quarters = (angle_rad * FK_QUARTERS_PER_RAD + FK_ROUND_SHIFT) - FK_ROUND_SHIFT;
    rest = ((angle_rad - quarters * FK_QUARTER_1_RAD) - quarters * FK_QUARTER_2_RAD)
         - quarters * FK_QUARTER_3_RAD;
    fk_sincos_small(rest, &sine_rest, &cosine_rest);
    /* |quarters| <= 1337 fits int32_t; the lowest two bits of two's complement are its value modulo 4. */
    quadrant = (uint32_t)(int32_t)quarters & 3U;
    if (quadrant == 0U) {
        *sine = sine_rest;
        *cosine = cosine_rest;
    } else if (quadrant == 1U) {
        *sine = cosine_rest;
        *cosine = -sine_rest;
    } else if (quadrant == 2U) {
        *sine = -sine_rest;
        *cosine = -cosine_rest;
    } else {
        *sine = -cosine_rest;
        *cosine = sine_rest;
    }
}

void fk_velocity_to_body(float heading_rad, float vx_world_mps, float vy_world_mps, float *vx_body_mps,
                         float *vy_body_mps)
{
    float sine;
    float cosine;

    fk_sincos(heading_rad, &sine, &cosine);
    *vx_body_mps = cosine * vx_world_mps + sine * vy_world_mps;
    *vy_body_mps = cosine * vy_world_mps - sine * vx_world_mps;
}

int32_t fk_float_check(void)
{
    /* Volatile, so that the machine and not the compiler computes. */
    volatile float factor_in = 1.000244140625f;   /* 1 + 2^-12 */
    volatile float product_in = 1.00048828125f;   /* 1 + 2^-11, the square rounded once to float32 */
    volatile float least_normal_in = FLT_MIN;
    float factor = factor_in;
    float product = product_in;
    float least_normal = least_normal_in;
    float other = factor_in;

    if (factor * other - product != 0.0f) {
        return FK_ERROR_FLOAT_RULES; /* 2^-24 was kept: fused, or excess precision */
    }
    if (least_normal * 0.5f == 0.0f) {
        return FK_ERROR_FLOAT_RULES; /* subnormals are flushed */
    }
    return FK_OK;
}
