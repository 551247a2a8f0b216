/* The crystal, the timer, PPI and the gates. */
#include <errno.h>
#include <string.h>

#include "played.h"

#define EDGES_MAX 4096

/* The crystal: whoever asks holds it until he gives it back. */

struct onoff_manager {
    int users;
};
static struct onoff_manager crystal;
static uint64_t crystal_takes_us = 1500; /* NEVER: it does not start */
static uint64_t crystal_runs_us = NEVER;

void sys_notify_init_spinwait(struct sys_notify *notify) { notify->state = 1; }
int sys_notify_fetch_result(const struct sys_notify *, int *result)
{
    if (now_us < crystal_runs_us) {
        return -EAGAIN;
    }
    *result = 0;
    return 0;
}
struct onoff_manager *z_nrf_clock_control_get_onoff(clock_control_subsys_t) { return &crystal; }
int onoff_request(struct onoff_manager *mgr, struct onoff_client *)
{
    if (mgr->users++ == 0) {
        crystal_runs_us = (crystal_takes_us == NEVER) ? NEVER : now_us + crystal_takes_us;
    }
    return 0;
}
int onoff_cancel_or_release(struct onoff_manager *mgr, struct onoff_client *)
{
    if (--mgr->users == 0) {
        crystal_runs_us = NEVER;
    }
    return 0;
}
bool nrf_clock_is_running(const NRF_CLOCK_Type *, nrf_clock_domain_t, void *p_clk_src)
{
    *(nrf_clock_hfclk_t *)p_clk_src =
        (now_us >= crystal_runs_us) ? NRF_CLOCK_HFCLK_HIGH_ACCURACY : NRF_CLOCK_HFCLK_LOW_ACCURACY;
    return true;
}

/* The supply and the comparator that warns of its fall: also where it is low when that is switched on. */

static int supply_is_low;
static nrfx_power_pofwarn_config_t warns;

void nrfx_power_pof_init(const nrfx_power_pofwarn_config_t *p_config) { warns = *p_config; }
void nrf_power_pofcon_set(NRF_POWER_Type *, bool enabled, nrf_power_pof_thr_t)
{
    if (enabled && supply_is_low) {
        warns.handler();
    }
}
void nrfx_power_pof_enable(const nrfx_power_pofwarn_config_t *p_config)
{
    nrf_power_pofcon_set(NRF_POWER, true, p_config->thr);
}
void play_supply(int is_low)
{
    supply_is_low = is_low;
    nrf_power_pofcon_set(NRF_POWER, true, warns.thr);
}

/* The converter: a battery at each of its channels, in millivolts at the pin */

#define CONVERSION_US 42u
#define FULL_SCALE_MV 3600
static int battery_mv[8];
static uint32_t battery_channels;
static int16_t *battery_results; /* halfwords, as the chip writes them */
static int converter_is_started; /* since when it has a buffer for the next readings */
static uint64_t converted_us = NEVER;

void nrf_saadc_channel_init(NRF_SAADC_Type *, uint8_t, const nrf_saadc_channel_config_t *) {}
void nrf_saadc_channel_input_set(NRF_SAADC_Type *, uint8_t channel, nrf_saadc_input_t, nrf_saadc_input_t)
{
    battery_channels = channel + 1u;
}
void nrf_saadc_resolution_set(NRF_SAADC_Type *, nrf_saadc_resolution_t) {}
void nrf_saadc_buffer_init(NRF_SAADC_Type *, nrf_saadc_value_t *p_buffer, uint32_t) { battery_results = p_buffer; }
void nrf_saadc_enable(NRF_SAADC_Type *) {}
void nrf_saadc_task_trigger(NRF_SAADC_Type *, nrf_saadc_task_t task)
{
    if (task == NRF_SAADC_TASK_START) {
        converter_is_started = 1;
    } else if (converter_is_started) {
        converted_us = now_us + CONVERSION_US * battery_channels;
    }
}
bool nrf_saadc_event_check(const NRF_SAADC_Type *, nrf_saadc_event_t)
{
    if (now_us < converted_us) {
        return false;
    }
    for (uint32_t i = 0; i < battery_channels; ++i) {
        battery_results[i] = (int16_t)(battery_mv[i] * 4096 / FULL_SCALE_MV);
    }
    return true;
}
void nrf_saadc_event_clear(NRF_SAADC_Type *, nrf_saadc_event_t)
{
    converted_us = NEVER;
    converter_is_started = 0;
}
void play_battery(uint32_t channel, int pin_mv) { battery_mv[channel] = pin_mv; }

/* The timer, PPI and the gates */

typedef struct {
    uint32_t event;
    uint32_t task;
    uint32_t fork;
    int enabled;
} channel_t;
typedef struct {
    uint64_t at_us;
    uint32_t pin;
    uint32_t level;
} edge_t;
#define EVENT_ADDRESS(channel) (0x1000u + (channel))
#define TASK_SET(pin) (0x2000u + (pin))
#define TASK_CLR(pin) (0x3000u + (pin))
static channel_t channels[32];
static uint32_t channels_used;
static uint8_t gpiote_used;
static uint32_t levels;
static edge_t edges[EDGES_MAX];
static uint32_t edge_count;
static uint32_t compare[4];
static uint64_t timer_us = NEVER; /* when the timer was 0 */
static int timer_enabled;
static int asserts; /* that nrfx would have raised */
static nrfx_timer_event_handler_t on_timer;

static void drive(uint32_t pin, uint32_t level)
{
    if ((levels >> pin & 1u) != level) {
        levels ^= 1u << pin;
        edges[edge_count++ % EDGES_MAX] = (edge_t){now_us, pin, level};
    }
}
static void trigger(uint32_t task)
{
    if (task != 0) {
        drive(task & 0xFFFu, (task & 0xF000u) == 0x2000u);
    }
}
static void timer_compares(uint32_t channel)
{
    for (uint32_t i = 0; i < 32; ++i) {
        if (channels[i].enabled && channels[i].event == EVENT_ADDRESS(channel)) {
            trigger(channels[i].task);
            trigger(channels[i].fork);
        }
    }
    if (channel == 0) {
        timer_us = NEVER; /* its shorts: stop and clear */
        on_timer(NRF_TIMER_EVENT_COMPARE0, NULL);
    }
}
void declared_connect(unsigned int, unsigned int, void (*)(const void *), void (*)(void), uint32_t) {}
void nrfx_isr(const void *) {}
void nrfx_timer_2_irq_handler(void) {}
bool nrfx_gpiote_init_check(const nrfx_gpiote_t *) { return false; }
nrfx_err_t nrfx_gpiote_init(const nrfx_gpiote_t *, uint8_t) { return NRFX_SUCCESS; }
nrfx_err_t nrfx_gpiote_channel_alloc(const nrfx_gpiote_t *, uint8_t *channel)
{
    *channel = gpiote_used++;
    return NRFX_SUCCESS;
}
nrfx_err_t nrfx_gpiote_output_configure(const nrfx_gpiote_t *, nrfx_gpiote_pin_t, const nrfx_gpiote_output_config_t *,
                                        const nrfx_gpiote_task_config_t *)
{
    return NRFX_SUCCESS;
}
void nrfx_gpiote_out_task_enable(const nrfx_gpiote_t *, nrfx_gpiote_pin_t) {}
void nrfx_gpiote_clr_task_trigger(const nrfx_gpiote_t *, nrfx_gpiote_pin_t pin) { drive(pin, 0); }
uint32_t nrfx_gpiote_clr_task_address_get(const nrfx_gpiote_t *, nrfx_gpiote_pin_t pin) { return TASK_CLR(pin); }
uint32_t nrfx_gpiote_set_task_address_get(const nrfx_gpiote_t *, nrfx_gpiote_pin_t pin) { return TASK_SET(pin); }
nrfx_err_t nrfx_timer_init(const nrfx_timer_t *, const nrfx_timer_config_t *, nrfx_timer_event_handler_t handler)
{
    on_timer = handler;
    return NRFX_SUCCESS;
}
static uint64_t halt_us; /* for which a debugger halts the processor before a timer is enabled */
void play_halt(uint64_t us) { halt_us = us; }
void nrfx_timer_enable(const nrfx_timer_t *)
{
    played_spend(halt_us);
    asserts += timer_enabled;
    timer_enabled = 1;
    timer_us = now_us;
}
void nrfx_timer_disable(const nrfx_timer_t *)
{
    timer_enabled = 0;
    timer_us = NEVER;
}
void nrfx_timer_clear(const nrfx_timer_t *) {}
void nrfx_timer_compare(const nrfx_timer_t *, nrf_timer_cc_channel_t channel, uint32_t value, bool)
{
    compare[channel] = value;
}
void nrfx_timer_extended_compare(const nrfx_timer_t *, nrf_timer_cc_channel_t channel, uint32_t value,
                                 nrf_timer_short_mask_t, bool)
{
    compare[channel] = value;
}
uint32_t nrfx_timer_compare_event_address_get(const nrfx_timer_t *, uint32_t channel) { return EVENT_ADDRESS(channel); }
nrfx_err_t nrfx_gppi_channel_alloc(uint8_t *channel)
{
    /* The controller of Bluetooth has 6 to 13 and those that are wired by the silicon. */
    static const uint8_t left[] = {0, 1, 2, 3, 4, 5, 14, 15, 16, 17, 18, 19};
    if (channels_used == sizeof(left)) {
        return NRFX_ERROR_NO_MEM;
    }
    *channel = left[channels_used++];
    return NRFX_SUCCESS;
}
void nrfx_gppi_channel_endpoints_setup(uint8_t channel, uint32_t eep, uint32_t tep)
{
    channels[channel].event = eep;
    channels[channel].task = tep;
}
void nrfx_gppi_fork_endpoint_setup(uint8_t channel, uint32_t fork_tep) { channels[channel].fork = fork_tep; }
static void switch_channels(uint32_t mask, int enabled)
{
    for (uint32_t i = 0; i < 32; ++i) {
        if (mask >> i & 1u) {
            channels[i].enabled = enabled;
        }
    }
}
void nrfx_gppi_channels_enable(uint32_t mask) { switch_channels(mask, 1); }
void nrfx_gppi_channels_disable(uint32_t mask) { switch_channels(mask, 0); }

static uint64_t compare_us(uint32_t channel)
{
    const uint64_t at_us = (timer_us == NEVER) ? NEVER : timer_us + compare[channel];
    return (at_us > now_us || at_us == NEVER) ? at_us : NEVER;
}

uint64_t played_gates_next_us(void)
{
    const uint64_t begin_us = compare_us(1);
    const uint64_t end_us = compare_us(0);
    return (begin_us < end_us) ? begin_us : end_us;
}
void played_gates_event(void)
{
    /* Where the timer was before: COMPARE0 clears it. */
    const uint64_t zero_us = timer_us;
    for (uint32_t channel = 2; channel-- > 0 && zero_us != NEVER;) {
        if (zero_us + compare[channel] == now_us) {
            timer_compares(channel);
        }
    }
}

uint32_t play_edges(edge_t *to)
{
    const uint32_t count = edge_count;
    memcpy(to, edges, count * sizeof(edges[0]));
    edge_count = 0;
    return count;
}
int play_asserts(void) { return asserts; }
void play_crystal(uint64_t takes_us) { crystal_takes_us = takes_us; }
void play_break_crystal(void) { crystal_runs_us = NEVER; }
int play_crystal_users(void) { return crystal.users; }
