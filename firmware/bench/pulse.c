#include "pulse.h"

#include "board.h"
#include "clock.h"
#include "nrf52832_regs.h"
#include "ppi_channels.h"
#include "time.h"

#define PULSE_TIMER TIMER2_BASE
#define PULSE_PRESCALER_1_MHZ 4u /* 16 MHz / 2^4 */
#define CC_END 0u
#define CC_BEGIN 1u

/* The gates go high at the timer's first tick, so the compare value of the end is one more than the length. */
#define BEGIN_TICK 1u
/* Time allowed from reading the clock until the compare value is set and its channel enabled; a try that takes
 * longer is repeated. */
#define ARM_US 5u
/* After this much more time a pulse that begins has begun. */
#define SETTLED_US 3u

#define START_MASK (1u << FK_PPI_PULSE_START)
#define LIMBS_MASK ((1u << FK_BOARD_LIMBS) - 1u)

static const uint8_t limb_pins[FK_BOARD_LIMBS_MAX] = FK_BOARD_LIMB_PINS;
static uint8_t pulse_is_on;

static void connect(uint32_t channel, volatile uint32_t *event, volatile uint32_t *task)
{
    PPI_CH_EEP(channel) = FK_ADDRESS_OF(*event);
    PPI_CH_TEP(channel) = FK_ADDRESS_OF(*task);
}

void fk_pulse_init(void)
{
    for (uint32_t limb = 0u; limb < FK_BOARD_LIMBS; ++limb) {
        uint32_t pin = limb_pins[limb];
        /* Low as a plain output first: GPIOTE takes over a pin that is already safe. */
        P0_OUTCLR = 1u << pin;
        P0_PIN_CNF(pin) =
            (P0_PIN_CNF_DIR_Output << P0_PIN_CNF_DIR_Pos) | (P0_PIN_CNF_INPUT_Disconnect << P0_PIN_CNF_INPUT_Pos);
        GPIOTE_CONFIG(limb) =
            (GPIOTE_CONFIG_MODE_Task << GPIOTE_CONFIG_MODE_Pos) | (pin << GPIOTE_CONFIG_PSEL_Pos) |
            (GPIOTE_CONFIG_POLARITY_None << GPIOTE_CONFIG_POLARITY_Pos) |
            (GPIOTE_CONFIG_OUTINIT_Low << GPIOTE_CONFIG_OUTINIT_Pos);
        connect(FK_PPI_PULSE_END_FIRST + limb, &TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END), &GPIOTE_TASKS_CLR(limb));
        connect(FK_PPI_PULSE_BEGIN_FIRST + limb, &TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_BEGIN), &GPIOTE_TASKS_SET(limb));
    }
    PPI_CHENSET = LIMBS_MASK << FK_PPI_PULSE_END_FIRST;
    connect(FK_PPI_PULSE_START, &TIMER_EVENTS_COMPARE(FK_TIME_TIMER, FK_TIME_CC_PULSE), &TIMER_TASKS_START(PULSE_TIMER));
    PPI_CHG(FK_PPI_GROUP_PULSE_START) = START_MASK;
    PPI_FORK_TEP(FK_PPI_PULSE_START) = FK_ADDRESS_OF(PPI_TASKS_CHG_DIS(FK_PPI_GROUP_PULSE_START));
    TIMER_MODE(PULSE_TIMER) = TIMER_MODE_MODE_Timer;
    TIMER_BITMODE(PULSE_TIMER) = TIMER_BITMODE_BITMODE_32Bit;
    TIMER_PRESCALER(PULSE_TIMER) = PULSE_PRESCALER_1_MHZ;
    TIMER_SHORTS(PULSE_TIMER) = TIMER_SHORTS_COMPARE0_CLEAR_Msk | TIMER_SHORTS_COMPARE0_STOP_Msk;
    TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END) = 0u;
    TIMER_INTENSET(PULSE_TIMER) = TIMER_INTENSET_COMPARE0_Msk;
    pulse_is_on = 0u;
}

/* A pulse leaves behind what costs current: a timer that was only stopped (erratum 78), and the constant-latency
 * mode that GPIOTE's CLR tasks cause (erratum 156). */
static void save_current(void)
{
    TIMER_TASKS_SHUTDOWN(PULSE_TIMER) = 1u;
    POWER_TASKS_LOWPWR = 1u;
}

int32_t fk_pulse_is_on(void)
{
    if (pulse_is_on != 0u && TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END) != 0u) {
        TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END) = 0u;
        (void)TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END); /* the write has arrived before the caller goes on */
        save_current();
        pulse_is_on = 0u;
    }
    return pulse_is_on;
}

/* Let the prepared pulse begin when TIMER0 reaches begin_us. Returns 1 where it has begun, 0 where that time was
 * over before the channel was enabled, so that nothing has begun. */
static int32_t begin_at(uint64_t begin_us)
{
    TIMER_CC(FK_TIME_TIMER, FK_TIME_CC_PULSE) = (uint32_t)begin_us;
    PPI_CHENSET = START_MASK; /* from here on the timers alone begin and end it */
    while (fk_time_now_us() < begin_us + SETTLED_US) {
    }
    if (TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_BEGIN) != 0u) {
        return 1;
    }
    PPI_CHENCLR = START_MASK;
    return 0;
}

int32_t fk_pulse_start(uint8_t limb_mask, uint32_t pulse_us, uint64_t latest_us)
{
    if (limb_mask == 0u || ((uint32_t)limb_mask >> FK_BOARD_LIMBS) != 0u || pulse_us == 0u ||
        pulse_us > FK_BOARD_PULSE_MAX_US) {
        return FK_PULSE_ERROR_RANGE;
    }
    if (fk_pulse_is_on() != 0) {
        return FK_PULSE_ERROR_BUSY;
    }
    if (fk_clock_is_exact() == 0) {
        return FK_PULSE_ERROR_CLOCK;
    }
    TIMER_TASKS_CLEAR(PULSE_TIMER) = 1u;
    TIMER_CC(PULSE_TIMER, CC_BEGIN) = BEGIN_TICK;
    TIMER_CC(PULSE_TIMER, CC_END) = BEGIN_TICK + pulse_us;
    TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_BEGIN) = 0u;
    PPI_CHENCLR = LIMBS_MASK << FK_PPI_PULSE_BEGIN_FIRST;
    PPI_CHENSET = (uint32_t)limb_mask << FK_PPI_PULSE_BEGIN_FIRST;
    pulse_is_on = 1u;
    for (;;) {
        uint64_t begin_us = fk_time_now_us() + ARM_US;
        if (begin_us + BEGIN_TICK > latest_us) {
            pulse_is_on = 0u;
            return FK_PULSE_ERROR_LATE;
        }
        if (begin_at(begin_us) != 0) {
            return FK_PULSE_OK;
        }
    }
}

void fk_pulse_off(void)
{
    /* In this order: no pulse can begin any more, all gates go low, and only then does the timer stop that would
     * end a pulse. */
    PPI_CHENCLR = FK_PPI_PULSE_BEGIN_MASK;
    for (uint32_t limb = 0u; limb < FK_BOARD_LIMBS; ++limb) {
        GPIOTE_TASKS_CLR(limb) = 1u;
    }
    TIMER_TASKS_STOP(PULSE_TIMER) = 1u;
    save_current();
    TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END) = 0u;
    (void)TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END);
    pulse_is_on = 0u;
}
