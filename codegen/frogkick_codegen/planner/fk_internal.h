/* fk_internal.h - shared by the planner's own files. */
#ifndef FK_INTERNAL_H
#define FK_INTERNAL_H

#include "fk_planner.h"

#include <float.h>
#include <stddef.h>
#if defined(__ARM_FEATURE_SIMD32)
#include <arm_acle.h>
#endif

#if defined(__FAST_MATH__)
#error "frogkick's planner needs IEEE float32: build without -ffast-math"
#endif
#if FLT_EVAL_METHOD != 0
#error "frogkick's planner keeps no excess precision: on 32-bit x86 add -msse2 -mfpmath=sse"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

/* Correctly rounded square root: IEEE 754 demands it of the instruction and of libm alike. The built-in
 * becomes one instruction under -fno-math-errno, so that no libm is linked. */
#if defined(__GNUC__)
#define FK_SQRT(value) __builtin_sqrtf(value)
#else
#include <math.h>
#define FK_SQRT(value) sqrtf(value)
#endif

/* A condition that seldom holds. The compiler then lays out the other branch without a jump. */
#if defined(__GNUC__)
#define FK_SELDOM(condition) __builtin_expect((condition) ? 1 : 0, 0)
#else
#define FK_SELDOM(condition) (condition)
#endif

/* A function that is inlined into each caller, because on the chip a call costs more than the copy; and a loop
 * that is not unrolled, because three copies of its body would leave no room in the instruction cache. */
#if defined(__GNUC__)
#define FK_INLINE static inline __attribute__((always_inline))
#define FK_ROLLED _Pragma("GCC unroll 1")
#else
#define FK_INLINE static inline
#define FK_ROLLED
#endif

/* Alignment fixes the search's position in the chip's instruction cache (two ways of 1 KB), whatever is linked
 * before it. Otherwise its largest function and the look-up that it calls evict each other in some builds, which
 * then are 5 % slower. */
#if defined(__GNUC__) && defined(__thumb__)
#define FK_CACHE_ALIGNED __attribute__((aligned(1024)))
#else
#define FK_CACHE_ALIGNED
#endif

/* Float bits, by union: C99 6.5.2.3 allows it, and no memcpy is needed. */
typedef union {
    float value;
    uint32_t bits;
} fk_float_bits_t;

static inline uint32_t fk_bits_of_float(float value)
{
    fk_float_bits_t both;
    both.value = value;
    return both.bits;
}

static inline float fk_float_of_bits(uint32_t bits)
{
    fk_float_bits_t both;
    both.bits = bits;
    return both.value;
}

#define FK_FLOAT_MAGNITUDE 0x7FFFFFFFU /* all bits but the sign: orders |values| like integers, NaN on top */
#define FK_FLOAT_INFINITY 0x7F800000U
#define FK_FLOAT_NAN 0x7FC00000U

/* Little-endian reads of any alignment. A packed type says to GNU compilers that the bytes may lie anywhere
 * and alias anything, and they make one load of it on the chip; elsewhere byte by byte. */
#if defined(__GNUC__) && (__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__)
typedef struct __attribute__((packed, may_alias)) {
    uint16_t value;
} fk_packed_u16_t;
typedef struct __attribute__((packed, may_alias)) {
    uint32_t value;
} fk_packed_u32_t;

static inline uint32_t fk_read_u16(const uint8_t *bytes)
{
    return ((const fk_packed_u16_t *)bytes)->value;
}

static inline uint32_t fk_read_u32(const uint8_t *bytes)
{
    return ((const fk_packed_u32_t *)bytes)->value;
}
#else
static inline uint32_t fk_read_u16(const uint8_t *bytes)
{
    return (uint32_t)bytes[0] | ((uint32_t)bytes[1] << 8);
}

static inline uint32_t fk_read_u32(const uint8_t *bytes)
{
    return fk_read_u16(bytes) | (fk_read_u16(bytes + 2) << 16);
}
#endif

static inline int32_t fk_read_i16(const uint8_t *bytes)
{
    /* u16 < 65536 fits int32_t; the conversion to int16_t keeps the two's complement bits (C99 6.3.1.3:
     * implementation-defined, and so defined by every compiler that builds for this chip). */
    return (int16_t)(uint16_t)fk_read_u16(bytes);
}

static inline float fk_read_f32(const uint8_t *bytes)
{
    return fk_float_of_bits(fk_read_u32(bytes));
}

/* The lower and the upper of two 16-bit numbers in one word. */
static inline int32_t fk_low(uint32_t two)
{
    return (int16_t)(uint16_t)two;
}

static inline int32_t fk_high(uint32_t two)
{
    return (int16_t)(uint16_t)(two >> 16);
}

static inline uint32_t fk_pair(int32_t low, int32_t high)
{
    return ((uint32_t)low & 0xFFFFU) | ((uint32_t)high << 16);
}

/* Products of halves added to a sum, and halves added to halves, where nothing overflows: one instruction each on the
 * chip, with the same result (ARM C Language Extensions, 32-bit SIMD). */
static inline int32_t fk_add_products(int32_t sum, uint32_t two, uint32_t by)
{
#if defined(__ARM_FEATURE_SIMD32)
    return __smlad((int16x2_t)two, (int16x2_t)by, sum);
#else
    return sum + fk_low(two) * fk_low(by) + fk_high(two) * fk_high(by);
#endif
}

static inline uint32_t fk_add_halves(uint32_t two, uint32_t by)
{
#if defined(__ARM_FEATURE_SIMD32)
    return (uint32_t)__sadd16((int16x2_t)two, (int16x2_t)by);
#else
    return fk_pair(fk_low(two) + fk_low(by), fk_high(two) + fk_high(by));
#endif
}

/* With the route cost a depth of FK_BEAM_DEPTH or more is a beam search, FK_BEAM_BEYOND levels deeper than that.
 * search_beam.c */
#define FK_BEAM 12U /* branches that are carried on */
#define FK_BEAM_DEPTH 3U
#define FK_BEAM_BEYOND 4U

/* Bytes of a column of kind affine: history of four limbs, or of eight. lookup.c */
#define FK_AFFINE_COLUMN_BYTES(limbs) (((limbs) > 4U) ? 24U : 16U)

/* Check a whole image; the first error found is returned. tables_check.c
 * @retval FK_OK, FK_ERROR_IMAGE_... */
int32_t fk_image_check(const uint8_t *image, uint32_t size);

/* Row of the table nearest to codes[3] (|code| <= FK_VELOCITY_CODE_MAX), the lowest on ties. nearest.c */
uint16_t fk_nearest(const fk_tables_t *tables, const int32_t codes[3]);

/* Cost of being at a pose; path and config checked. cost.c */
float fk_cost(const fk_path_t *path, const fk_plan_config_t *config, float x_m, float y_m, float heading_rad);

/* FK_OK or FK_ERROR_FLOAT_RULES: whether this build keeps the float rules. math.c */
int32_t fk_float_check(void);

#endif
