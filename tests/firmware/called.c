/* Functions for test_chip_calls.py to call from outside; main only sleeps. */
#include <stdint.h>

typedef struct {
    uint8_t small;
    int16_t pair[2];
    float value;
} fk_inner_t;

typedef struct {
    uint16_t count;
    fk_inner_t inner[2];
    uint64_t wide;
} fk_outer_t;

int main(void);
uint32_t sum(uint32_t a, uint32_t b, uint32_t c, uint32_t d, uint32_t e, uint32_t f);
uint32_t scaled(float factor, uint32_t words, float addend);
uint32_t fill(fk_outer_t *outer);
uint32_t slow(uint32_t turns);
uint32_t broken(void);

uint32_t sum(uint32_t a, uint32_t b, uint32_t c, uint32_t d, uint32_t e, uint32_t f)
{
    return a + 2u * b + 3u * c + 4u * d + 5u * e + 6u * f;
}

uint32_t scaled(float factor, uint32_t words, float addend) { return (uint32_t)(factor * (float)words + addend); }

uint32_t fill(fk_outer_t *outer)
{
    outer->inner[1].pair[1] = (int16_t)(outer->count * -2);
    outer->inner[1].value = 0.5f * outer->inner[0].value;
    outer->wide += 1u;
    return outer->inner[0].small;
}

uint32_t slow(uint32_t turns)
{
    while (turns > 0u) {
        __asm__ volatile("nop\n nop\n nop");
        turns -= 1u;
    }
    return 7u;
}

uint32_t broken(void)
{
    __asm__ volatile("udf #0");
    return 0u;
}

int main(void)
{
    /* Their addresses are wanted, so that the linker keeps them. */
    __asm__ volatile("" : : "r"(sum), "r"(scaled), "r"(fill), "r"(slow), "r"(broken));
    for (;;) {
        __asm__ volatile("wfe");
    }
}
