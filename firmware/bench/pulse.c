#include "pulse.h"

#include "board.h"
#include "nrf52832_regs.h"
#include "ppi_channels.h"

#define PULSE_TIMER TIMER2_BASE
#define PULSE_PRESCALER_1_MHZ 4u /* 16 MHz / 2^4 */
#define CC_END 0u

static const uint8_t limb_pins[FK_BOARD_LIMBS_MAX] = FK_BOARD_LIMB_PINS;
static uint8_t pulse_is_on;

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
        uint32_t channel = FK_PPI_PULSE_END_FIRST + limb;
        PPI_CH_EEP(channel) = FK_ADDRESS_OF(TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END));
        PPI_CH_TEP(channel) = FK_ADDRESS_OF(GPIOTE_TASKS_CLR(limb));
        PPI_CHENSET = 1u << channel;
    }
    TIMER_MODE(PULSE_TIMER) = TIMER_MODE_MODE_Timer;
    TIMER_BITMODE(PULSE_TIMER) = TIMER_BITMODE_BITMODE_32Bit;
    TIMER_PRESCALER(PULSE_TIMER) = PULSE_PRESCALER_1_MHZ;
    TIMER_SHORTS(PULSE_TIMER) = TIMER_SHORTS_COMPARE0_CLEAR_Msk | TIMER_SHORTS_COMPARE0_STOP_Msk;
    TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END) = 0u;
    TIMER_INTENSET(PULSE_TIMER) = TIMER_INTENSET_COMPARE0_Msk;
    pulse_is_on = 0u;
}

int32_t fk_pulse_is_on(void)
{
    if (pulse_is_on != 0u && TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END) != 0u) {
        TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END) = 0u;
        (void)TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END); /* the write has arrived before the caller goes on */
        pulse_is_on = 0u;
    }
    return pulse_is_on;
}

int32_t fk_pulse_start(uint8_t limb_mask, uint32_t pulse_us)
{
    if (limb_mask == 0u || ((uint32_t)limb_mask >> FK_BOARD_LIMBS) != 0u || pulse_us == 0u ||
        pulse_us > FK_BOARD_PULSE_MAX_US) {
        return FK_PULSE_ERROR_RANGE;
    }
    if (fk_pulse_is_on() != 0) {
        return FK_PULSE_ERROR_BUSY;
    }
    TIMER_TASKS_CLEAR(PULSE_TIMER) = 1u;
    TIMER_CC(PULSE_TIMER, CC_END) = pulse_us;
    pulse_is_on = 1u;
    /* The end first, then the beginning: whatever stops the core between these lines, no gate stays high. */
    TIMER_TASKS_START(PULSE_TIMER) = 1u;
    for (uint32_t limb = 0u; limb < FK_BOARD_LIMBS; ++limb) {
        if ((limb_mask & (1u << limb)) != 0u) {
            GPIOTE_TASKS_SET(limb) = 1u;
        }
    }
    return FK_PULSE_OK;
}

void fk_pulse_off(void)
{
    for (uint32_t limb = 0u; limb < FK_BOARD_LIMBS; ++limb) {
        GPIOTE_TASKS_CLR(limb) = 1u;
    }
    TIMER_TASKS_STOP(PULSE_TIMER) = 1u;
    TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END) = 0u;
    (void)TIMER_EVENTS_COMPARE(PULSE_TIMER, CC_END);
    pulse_is_on = 0u;
}
