#include "supply.h"

#include <hal/nrf_power.h>
#include <nrfx_power.h>
#include <zephyr/sys/atomic.h>

/* The power-fail comparator reports a supply that falls, not one that has recovered. So it is switched off and on
 * again, and where it reports nothing for this long, the supply is sufficient. It works while the chip's 64 MHz
 * clock runs, so while the processor or the limbs' timer does. */
#define SETTLED_US 1000u

#define LEAST NRF_POWER_POFTHR_V27

static void (*on_fall)(void);
static atomic_t has_fallen;
static uint8_t is_low;
static uint8_t is_asked;
static uint64_t asked_us;

static void on_warning(void)
{
    atomic_set(&has_fallen, 1);
    on_fall();
}

static const nrfx_power_pofwarn_config_t warning = {.handler = on_warning, .thr = LEAST};

void fk_supply_init(void (*fell)(void))
{
    on_fall = fell;
    nrfx_power_pof_init(&warning);
    nrfx_power_pof_enable(&warning);
}

int32_t fk_supply_is_low(uint64_t now_us)
{
    if (atomic_set(&has_fallen, 0) != 0) {
        is_low = 1u;
        is_asked = 0u;
    } else if (is_low != 0u && is_asked == 0u) {
        nrf_power_pofcon_set(NRF_POWER, false, LEAST);
        nrf_power_pofcon_set(NRF_POWER, true, LEAST);
        asked_us = now_us;
        is_asked = 1u;
    } else if (is_low != 0u && now_us - asked_us >= SETTLED_US) {
        is_low = 0u;
    }
    return is_low;
}
