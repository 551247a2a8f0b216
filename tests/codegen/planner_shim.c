/* planner_shim.c - what of the planner's tests has to be done in C: a table opened while the processor breaks a float
 * rule, as an application may have set it up; every angle there is. */
#include "fk_planner.h"

#if defined(_WIN32)
#define FK_EXPORT __declspec(dllexport)
#else
#define FK_EXPORT __attribute__((visibility("default")))
#endif

FK_EXPORT int32_t fk_test_open_spoiled(const uint8_t *image, uint32_t size, uint32_t flush, fk_tables_t *tables);
FK_EXPORT uint32_t fk_test_wrapped_wrong(uint32_t step);

#if defined(__x86_64__)
static uint32_t fk_float_control(void)
{
    return __builtin_ia32_stmxcsr();
}

static void fk_set_float_control(uint32_t control)
{
    __builtin_ia32_ldmxcsr(control);
}

#define FK_FLUSH 0x8000U    /* subnormals become 0 */
#define FK_ROUND_UP 0x4000U /* towards plus infinity */
#elif defined(__aarch64__)
static uint64_t fk_float_control(void)
{
    uint64_t control;
    __asm__ volatile("mrs %0, fpcr" : "=r"(control));
    return control;
}

static void fk_set_float_control(uint64_t control)
{
    __asm__ volatile("msr fpcr, %0" : : "r"(control));
}

#define FK_FLUSH (1UL << 24)
#define FK_ROUND_UP (1UL << 22)
#else
#error "how this processor flushes subnormals and rounds upwards is not written here yet"
#endif

/* flush: 1 = subnormals are flushed, 0 = everything is rounded upwards. */
int32_t fk_test_open_spoiled(const uint8_t *image, uint32_t size, uint32_t flush, fk_tables_t *tables)
{
    int32_t status;

    fk_set_float_control(fk_float_control() | ((flush != 0U) ? FK_FLUSH : FK_ROUND_UP));
    status = fk_tables_open(image, size, tables);
    fk_set_float_control(fk_float_control() & ~((flush != 0U) ? FK_FLUSH : FK_ROUND_UP));
    return status;
}

/* How many of every step-th float32 angle from FK_PI to FK_ANGLE_MAX_RAD, of both signs, are not wrapped to
 * (-FK_PI, FK_PI]. */
uint32_t fk_test_wrapped_wrong(uint32_t step)
{
    union {
        float value;
        uint32_t bits;
    } angle;
    uint32_t wrong = 0U;

    angle.value = FK_PI; /* what lies within is answered as it is */
    while (angle.value <= FK_ANGLE_MAX_RAD) {
        const float one = fk_wrap_angle(angle.value);
        const float other = fk_wrap_angle(-angle.value);

        wrong += ((one > -FK_PI) && (one <= FK_PI)) ? 0U : 1U;
        wrong += ((other > -FK_PI) && (other <= FK_PI)) ? 0U : 1U;
        angle.bits += step;
    }
    return wrong;
}
