#include "time.h"

#include "nrf52832_regs.h"

#define TIME_PRESCALER_1_MHZ 4u /* 16 MHz / 2^4 */
#define CC_WAKE 0u
#define CC_NOW 1u
#define SLEEP_MAX_US 0x80000000u

static uint32_t high_word;
static uint32_t last_low_word;

void fk_time_init(void)
{
    TIMER_MODE(FK_TIME_TIMER) = TIMER_MODE_MODE_Timer;
    TIMER_BITMODE(FK_TIME_TIMER) = TIMER_BITMODE_BITMODE_32Bit;
    TIMER_PRESCALER(FK_TIME_TIMER) = TIME_PRESCALER_1_MHZ;
    TIMER_TASKS_CLEAR(FK_TIME_TIMER) = 1u;
    TIMER_EVENTS_COMPARE(FK_TIME_TIMER, CC_WAKE) = 0u;
    TIMER_INTENSET(FK_TIME_TIMER) = TIMER_INTENSET_COMPARE0_Msk;
    TIMER_TASKS_START(FK_TIME_TIMER) = 1u;
    high_word = 0u;
    last_low_word = 0u;
}

uint64_t fk_time_now_us(void)
{
    TIMER_TASKS_CAPTURE(FK_TIME_TIMER, CC_NOW) = 1u;
    uint32_t low_word = TIMER_CC(FK_TIME_TIMER, CC_NOW);
    if (low_word < last_low_word) {
        ++high_word;
    }
    last_low_word = low_word;
    return ((uint64_t)high_word << 32) | low_word;
}

int32_t fk_time_wake_at(uint64_t wake_us)
{
    uint64_t latest_us = fk_time_now_us() + SLEEP_MAX_US;
    if (wake_us > latest_us) {
        wake_us = latest_us;
    }
    TIMER_CC(FK_TIME_TIMER, CC_WAKE) = (uint32_t)wake_us;
    /* Read the clock again now that the compare value is set: a time that is still ahead cannot be missed. */
    return (fk_time_now_us() < wake_us) ? 1 : 0;
}

void fk_time_clear_wake(void)
{
    TIMER_EVENTS_COMPARE(FK_TIME_TIMER, CC_WAKE) = 0u;
    (void)TIMER_EVENTS_COMPARE(FK_TIME_TIMER, CC_WAKE); /* the write has arrived before the caller goes on */
}
