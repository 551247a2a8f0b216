/* A stage for the robot's Zephyr application: its two threads, one at a time, in simulated time, and as much of the
 * kernel, of Bluetooth and of the timer's hardware as they touch. tests/firmware/zephyr_life.py plays on it.
 *
 * Threads switch where they wait and nowhere else, so that a life is the same every time. Computing takes no time. */
#include <errno.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "declared.h"

#define NEVER UINT64_MAX
#define THREADS 2 /* 0: main, of Zephyr's default priority 0; 1: the one that the application defines */
#define TICKS_PER_S 32768u
#define CONNECTION_INTERVAL_US 15000u
#define BUFFERS_MAX 16
#define SENT_MAX 65536
#define EDGES_MAX 4096
#define SWITCHES_MAX 1000000

int fk_zephyr_main(void);

const struct device declared_device = {"stand-in"};

/* Time and threads */

typedef struct {
    pthread_t thread;
    struct k_sem *sem; /* waits for it, or NULL */
    uint64_t until_us;
    int waits;
    int gave; /* the semaphore, not the time, ended its wait */
} player_t;

static pthread_mutex_t baton = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t passed = PTHREAD_COND_INITIALIZER;
static player_t players[THREADS];
static int on_stage = -1; /* -1: the test */
static uint64_t now_us;
static int switches;

static void hand_over(int to)
{
    const int me = on_stage;
    on_stage = to;
    pthread_cond_broadcast(&passed);
    while (on_stage != me) {
        pthread_cond_wait(&passed, &baton);
    }
}

/* @return 1 where the semaphore was given, 0 where the time was over */
static int wait_for(struct k_sem *sem, uint64_t until_us)
{
    player_t *player = &players[on_stage];
    player->sem = sem;
    player->until_us = until_us;
    player->waits = 1;
    hand_over(-1);
    return player->gave;
}

static int is_ready(player_t *player)
{
    if (player->waits == 0) {
        return 1;
    }
    if (player->sem != NULL && player->sem->count > 0) {
        --player->sem->count;
        player->gave = 1;
    } else if (player->until_us <= now_us) {
        player->gave = 0;
    } else {
        return 0;
    }
    player->waits = 0;
    return 1;
}

k_timeout_t declared_usec(uint64_t microseconds)
{
    return (k_timeout_t){(int64_t)((microseconds == UINT64_MAX) ? -1 : (int64_t)microseconds)};
}

static uint64_t end_of(k_timeout_t timeout)
{
    /* Whole ticks, one more than begun: no wait is shorter than it was told. */
    const uint64_t ticks = now_us * TICKS_PER_S / 1000000u + (uint64_t)timeout.ticks * TICKS_PER_S / 1000000u + 2u;
    return (timeout.ticks < 0) ? NEVER : (ticks * 1000000u + TICKS_PER_S - 1u) / TICKS_PER_S;
}

void k_sem_give(struct k_sem *sem) { sem->count = 1; }

int k_sem_take(struct k_sem *sem, k_timeout_t timeout)
{
    if (sem->count > 0) {
        --sem->count;
        return 0;
    }
    if (timeout.ticks == 0) {
        return -EBUSY;
    }
    return wait_for(sem, end_of(timeout)) ? 0 : -EAGAIN;
}

int32_t k_sleep(k_timeout_t timeout)
{
    (void)wait_for(NULL, end_of(timeout));
    return 0;
}

int64_t k_uptime_ticks(void) { return (int64_t)(now_us * TICKS_PER_S / 1000000u); }
int64_t k_uptime_get(void) { return (int64_t)(now_us / 1000u); }
uint64_t k_ticks_to_us_floor64(uint64_t t) { return t * 1000000u / TICKS_PER_S; }
int k_work_submit(struct k_work *work)
{
    work->handler(work);
    return 0;
}
unsigned int irq_lock(void) { return 0; }
void irq_unlock(unsigned int key) { (void)key; }
bool atomic_cas(atomic_t *target, atomic_val_t old_value, atomic_val_t new_value)
{
    const bool equal = *target == old_value;
    *target = equal ? new_value : *target;
    return equal;
}
atomic_val_t atomic_set(atomic_t *target, atomic_val_t value)
{
    const atomic_val_t before = *target;
    *target = value;
    return before;
}
atomic_val_t atomic_get(const atomic_t *target) { return *target; }
atomic_val_t atomic_inc(atomic_t *target) { return (*target)++; }
void printk(const char *fmt, ...) { (void)fmt; }

/* The only ring buffer of the application. */
static uint8_t ring[4096];
static uint32_t ring_in;
static uint32_t ring_out;
uint32_t ring_buf_put(struct ring_buf *buf, const uint8_t *data, uint32_t size)
{
    uint32_t put = 0;
    while (put < size && ring_in - ring_out < buf->size) {
        ring[ring_in++ % sizeof(ring)] = data[put++];
    }
    return put;
}
uint32_t ring_buf_get(struct ring_buf *buf, uint8_t *data, uint32_t size)
{
    uint32_t got = 0;
    (void)buf;
    while (got < size && ring_in != ring_out) {
        data[got++] = ring[ring_out++ % sizeof(ring)];
    }
    return got;
}

/* Drivers */

static uint64_t fed_us;
static uint64_t fed_gap_us; /* the longest time between two feeds */
int wdt_install_timeout(const struct device *dev, const struct wdt_timeout_cfg *cfg)
{
    (void)dev;
    (void)cfg;
    return 0;
}
int wdt_setup(const struct device *dev, uint8_t options)
{
    (void)dev;
    (void)options;
    fed_us = now_us;
    return 0;
}
static uint64_t gap_us(void) { return (now_us - fed_us > fed_gap_us) ? now_us - fed_us : fed_gap_us; }
int wdt_feed(const struct device *dev, int channel_id)
{
    (void)dev;
    (void)channel_id;
    fed_gap_us = gap_us();
    fed_us = now_us;
    return 0;
}
uint8_t declared_flash[0x32000] __attribute__((aligned(4096)));
int flash_erase(const struct device *dev, off_t offset, size_t size)
{
    (void)dev;
    memset((void *)(uintptr_t)offset, 0xFF, size);
    return 0;
}
int flash_write(const struct device *dev, off_t offset, const void *data, size_t len)
{
    (void)dev;
    for (size_t i = 0; i < len; ++i) {
        ((uint8_t *)(uintptr_t)offset)[i] &= ((const uint8_t *)data)[i];
    }
    return 0;
}
int settings_load(void) { return 0; }
ssize_t hwinfo_get_device_id(uint8_t *buffer, size_t length)
{
    memset(buffer, 1, length);
    return (ssize_t)length;
}
int hwinfo_get_reset_cause(uint32_t *cause)
{
    *cause = 0;
    return 0;
}
int hwinfo_clear_reset_cause(void) { return 0; }

/* Bluetooth: one connection. A notification holds a buffer from the call until the host has taken it, at the next
 * connection event of a link that is not faded. Without a free buffer the call waits, as bt_att_create_pdu does. */

struct bt_conn {
    int references;
};
static struct bt_conn the_conn;
static int is_connected;
static int is_subscribed;
static int is_faded;
static int refusal;  /* what bt_gatt_notify returns, 0: what is so */
static int accepted; /* notifications that it takes before it refuses */
static uint16_t mtu = 23;
static int buffers_free = 3;
static int buffers = 3;
static int buffers_used;
static uint64_t interval_us = NEVER;
static uint8_t sent[SENT_MAX];
static uint32_t sent_bytes;
static uint8_t in_air[BUFFERS_MAX][256];
static uint32_t in_air_bytes[BUFFERS_MAX];
static int notified_by = -1;
static struct k_sem buffer_free;

int bt_enable(void (*ready)(int err))
{
    (void)ready;
    return 0;
}
int bt_le_adv_start(const struct bt_le_adv_param *param, const struct bt_data *ad, size_t ad_len,
                    const struct bt_data *sd, size_t sd_len)
{
    (void)param;
    (void)ad;
    (void)ad_len;
    (void)sd;
    (void)sd_len;
    return 0;
}
void bt_foreach_bond(uint8_t id, void (*func)(const struct bt_bond_info *info, void *user_data), void *user_data)
{
    (void)id;
    (void)func;
    (void)user_data;
}
int bt_conn_get_info(const struct bt_conn *conn, struct bt_conn_info *info)
{
    (void)conn;
    info->state = is_connected ? BT_CONN_STATE_CONNECTED : BT_CONN_STATE_DISCONNECTED;
    return 0;
}
struct bt_conn *bt_conn_ref(struct bt_conn *conn)
{
    ++conn->references;
    return conn;
}
void bt_conn_unref(struct bt_conn *conn) { --conn->references; }
void bt_conn_foreach(int type, void (*func)(struct bt_conn *conn, void *data), void *data)
{
    (void)type;
    if (is_connected) {
        func(&the_conn, data);
    }
}
int bt_conn_auth_cb_register(const struct bt_conn_auth_cb *cb)
{
    (void)cb;
    return 0;
}
int bt_passkey_set(unsigned int passkey)
{
    (void)passkey;
    return 0;
}
uint16_t bt_gatt_get_mtu(struct bt_conn *conn)
{
    (void)conn;
    return mtu;
}

int bt_gatt_notify(struct bt_conn *conn, const struct bt_gatt_attr *attr, const void *data, uint16_t len)
{
    (void)conn;
    notified_by = on_stage;
    if (attr != declared_attributes + 2 || len > mtu - 3) {
        return -ENOMEM;
    }
    if (refusal != 0 && accepted == 0) {
        return refusal;
    }
    accepted -= (refusal != 0) ? 1 : 0;
    while (is_connected && buffers_free == 0) {
        (void)wait_for(&buffer_free, NEVER);
    }
    if (!is_connected) {
        return -ENOTCONN;
    }
    if (!is_subscribed) {
        return -EINVAL;
    }
    --buffers_free;
    memcpy(in_air[buffers_used], data, len);
    in_air_bytes[buffers_used++] = len;
    return 0;
}

static void connection_event(void)
{
    interval_us = now_us + CONNECTION_INTERVAL_US;
    if (is_faded) {
        return;
    }
    for (int i = 0; i < buffers_used; ++i) {
        memcpy(sent + sent_bytes, in_air[i], in_air_bytes[i]);
        sent_bytes += in_air_bytes[i];
    }
    buffers_used = 0;
    buffers_free = buffers;
    buffer_free.count = 1;
}

/* The crystal. Whoever asks holds it until he gives it back; without it the timer is slow. */

#define HFINT_PERCENT 108u
struct onoff_manager {
    int users;
};
static struct onoff_manager crystal;
static uint64_t crystal_takes_us = 1500; /* NEVER: it does not start */
static uint64_t crystal_runs_us = NEVER;
static uint64_t held_from_us = NEVER;
static int releases_without_request;

void sys_notify_init_spinwait(struct sys_notify *notify) { notify->state = 1; }
int sys_notify_fetch_result(const struct sys_notify *notify, int *result)
{
    (void)notify;
    if (now_us < crystal_runs_us) {
        return -EAGAIN;
    }
    *result = 0;
    return 0;
}
struct onoff_manager *z_nrf_clock_control_get_onoff(clock_control_subsys_t sys)
{
    (void)sys;
    return &crystal;
}
int onoff_request(struct onoff_manager *mgr, struct onoff_client *cli)
{
    (void)cli;
    if (mgr->users++ == 0) {
        crystal_runs_us = (crystal_takes_us == NEVER) ? NEVER : now_us + crystal_takes_us;
        held_from_us = now_us;
    }
    return 0;
}
int onoff_cancel_or_release(struct onoff_manager *mgr, struct onoff_client *cli)
{
    (void)cli;
    releases_without_request += mgr->users == 0;
    if (--mgr->users == 0) {
        crystal_runs_us = NEVER;
    }
    return 0;
}
bool nrf_clock_is_running(const NRF_CLOCK_Type *p_reg, nrf_clock_domain_t domain, void *p_clk_src)
{
    (void)p_reg;
    (void)domain;
    *(nrf_clock_hfclk_t *)p_clk_src =
        (now_us >= crystal_runs_us) ? NRF_CLOCK_HFCLK_HIGH_ACCURACY : NRF_CLOCK_HFCLK_LOW_ACCURACY;
    return true;
}

/* The timer, PPI and the gates */

typedef struct {
    uint32_t event;
    uint32_t task;
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
static uint32_t timer_percent;
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
static void timer_compares(uint32_t channel)
{
    for (uint32_t i = 0; i < channels_used; ++i) {
        if (channels[i].enabled && channels[i].event == EVENT_ADDRESS(channel)) {
            drive(channels[i].task & 0xFFFu, (channels[i].task & 0xF000u) == 0x2000u);
        }
    }
    if (channel == 0) {
        timer_us = NEVER; /* its shorts: stop and clear */
        on_timer(NRF_TIMER_EVENT_COMPARE0, NULL);
    }
}
void declared_connect(unsigned int line, unsigned int priority, void (*routine)(const void *),
                      void (*parameter)(void), uint32_t flags)
{
    (void)line;
    (void)priority;
    (void)routine;
    (void)parameter;
    (void)flags;
}
void nrfx_isr(const void *irq_handler) { (void)irq_handler; }
void nrfx_timer_2_irq_handler(void) {}
bool nrfx_gpiote_init_check(const nrfx_gpiote_t *instance)
{
    (void)instance;
    return false;
}
nrfx_err_t nrfx_gpiote_init(const nrfx_gpiote_t *instance, uint8_t interrupt_priority)
{
    (void)instance;
    (void)interrupt_priority;
    return NRFX_SUCCESS;
}
nrfx_err_t nrfx_gpiote_channel_alloc(const nrfx_gpiote_t *instance, uint8_t *channel)
{
    (void)instance;
    *channel = gpiote_used++;
    return NRFX_SUCCESS;
}
nrfx_err_t nrfx_gpiote_output_configure(const nrfx_gpiote_t *instance, nrfx_gpiote_pin_t pin,
                                        const nrfx_gpiote_output_config_t *config,
                                        const nrfx_gpiote_task_config_t *task_config)
{
    (void)instance;
    (void)pin;
    (void)config;
    (void)task_config;
    return NRFX_SUCCESS;
}
void nrfx_gpiote_out_task_enable(const nrfx_gpiote_t *instance, nrfx_gpiote_pin_t pin)
{
    (void)instance;
    (void)pin;
}
void nrfx_gpiote_clr_task_trigger(const nrfx_gpiote_t *instance, nrfx_gpiote_pin_t pin)
{
    (void)instance;
    drive(pin, 0);
}
uint32_t nrfx_gpiote_clr_task_address_get(const nrfx_gpiote_t *instance, nrfx_gpiote_pin_t pin)
{
    (void)instance;
    return TASK_CLR(pin);
}
uint32_t nrfx_gpiote_set_task_address_get(const nrfx_gpiote_t *instance, nrfx_gpiote_pin_t pin)
{
    (void)instance;
    return TASK_SET(pin);
}
nrfx_err_t nrfx_timer_init(const nrfx_timer_t *instance, const nrfx_timer_config_t *config,
                           nrfx_timer_event_handler_t handler)
{
    (void)instance;
    (void)config;
    on_timer = handler;
    return NRFX_SUCCESS;
}
void nrfx_timer_enable(const nrfx_timer_t *instance)
{
    (void)instance;
    asserts += timer_enabled;
    timer_enabled = 1;
    timer_us = now_us;
    timer_percent = (now_us >= crystal_runs_us) ? 100u : HFINT_PERCENT;
}
void nrfx_timer_disable(const nrfx_timer_t *instance)
{
    (void)instance;
    timer_enabled = 0;
    timer_us = NEVER;
}
void nrfx_timer_clear(const nrfx_timer_t *instance) { (void)instance; }
void nrfx_timer_compare(const nrfx_timer_t *instance, nrf_timer_cc_channel_t channel, uint32_t value,
                        bool enable_int)
{
    (void)instance;
    (void)enable_int;
    compare[channel] = value;
}
void nrfx_timer_extended_compare(const nrfx_timer_t *instance, nrf_timer_cc_channel_t channel, uint32_t value,
                                 uint32_t shorts, bool enable_int)
{
    (void)shorts;
    nrfx_timer_compare(instance, channel, value, enable_int);
}
uint32_t nrfx_timer_compare_event_address_get(const nrfx_timer_t *instance, uint32_t channel)
{
    (void)instance;
    return EVENT_ADDRESS(channel);
}
nrfx_err_t nrfx_gppi_channel_alloc(uint8_t *channel)
{
    *channel = (uint8_t)channels_used++;
    return NRFX_SUCCESS;
}
void nrfx_gppi_channel_endpoints_setup(uint8_t channel, uint32_t eep, uint32_t tep)
{
    channels[channel].event = eep;
    channels[channel].task = tep;
}
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

/* The test's side */

static uint64_t least(uint64_t a, uint64_t b) { return (a < b) ? a : b; }

static uint64_t compare_us(uint32_t channel)
{
    const uint64_t at_us = (timer_us == NEVER) ? NEVER : timer_us + (uint64_t)compare[channel] * timer_percent / 100u;
    return (at_us > now_us || at_us == NEVER) ? at_us : NEVER;
}

static void *play_main(void *nothing)
{
    pthread_mutex_lock(&baton);
    while (on_stage != 0) {
        pthread_cond_wait(&passed, &baton);
    }
    (void)fk_zephyr_main();
    (void)wait_for(NULL, NEVER);
    return nothing;
}

static void *play_other(void *nothing)
{
    pthread_mutex_lock(&baton);
    while (on_stage != 1) {
        pthread_cond_wait(&passed, &baton);
    }
    declared_thread.entry(NULL, NULL, NULL);
    (void)wait_for(NULL, NEVER);
    return nothing;
}

void play_begin(void);
int play_until(uint64_t until_us);
void play_connect(int subscribed);
void play_disconnect(void);
void play_fade(int faded);
void play_mtu(uint32_t bytes);
void play_refuse(int error, int after);
void play_write(const uint8_t *bytes, uint32_t length);
uint32_t play_sent(uint8_t *bytes);
uint32_t play_edges(edge_t *to);
uint64_t play_watchdog_us(void);
int play_asserts(void);
int play_notified_by(void);
void play_crystal(uint64_t takes_us);
int play_crystal_users(void);
uint64_t play_crystal_held_us(void);
void play_break_crystal(void);

void play_begin(void)
{
    memset(declared_flash, 0xFF, sizeof(declared_flash));
    (void)pthread_create(&players[0].thread, NULL, play_main, NULL);
    (void)pthread_create(&players[1].thread, NULL, play_other, NULL);
}

/* @return 0, or 1 where threads go on for ever without time going on */
int play_until(uint64_t until_us)
{
    pthread_mutex_lock(&baton);
    switches = 0;
    for (;;) {
        int ready = 0;
        while (ready < THREADS && !is_ready(&players[ready])) {
            ++ready;
        }
        if (ready < THREADS) {
            hand_over(ready);
            if (++switches > SWITCHES_MAX) {
                break;
            }
            continue;
        }
        const uint64_t begin_us = compare_us(1);
        const uint64_t end_us = compare_us(0);
        uint64_t next_us = least(least(begin_us, end_us), interval_us);
        next_us = least(next_us, least(players[0].until_us, players[1].until_us));
        if (next_us > until_us) {
            now_us = until_us;
            break;
        }
        now_us = next_us;
        if (now_us == begin_us) {
            timer_compares(1);
        }
        if (now_us == end_us) {
            timer_compares(0);
        }
        if (now_us == interval_us) {
            connection_event();
        }
    }
    pthread_mutex_unlock(&baton);
    return switches > SWITCHES_MAX;
}

void play_connect(int subscribed)
{
    is_connected = 1;
    is_subscribed = subscribed;
    is_faded = 0;
    interval_us = now_us + CONNECTION_INTERVAL_US;
}
void play_disconnect(void)
{
    is_connected = 0;
    interval_us = NEVER;
    buffers_used = 0;
    buffers_free = buffers;
    buffer_free.count = 1;
    declared_conn_cb.disconnected(&the_conn, 8);
    declared_conn_cb.recycled();
}
void play_fade(int faded) { is_faded = faded; }
void play_mtu(uint32_t bytes) { mtu = (uint16_t)bytes; }
void play_refuse(int error, int after)
{
    refusal = error;
    accepted = after;
}
void play_write(const uint8_t *bytes, uint32_t length)
{
    while (length > 0) {
        const uint32_t part = (length < mtu - 3u) ? length : mtu - 3u;
        for (const struct bt_gatt_attr *attribute = declared_attributes;; ++attribute) {
            if (attribute->write != NULL) {
                (void)attribute->write(&the_conn, attribute, bytes, (uint16_t)part, 0, 0);
                break;
            }
        }
        bytes += part;
        length -= part;
    }
}
uint32_t play_sent(uint8_t *bytes)
{
    const uint32_t count = sent_bytes;
    memcpy(bytes, sent, count);
    sent_bytes = 0;
    return count;
}
uint32_t play_edges(edge_t *to)
{
    const uint32_t count = edge_count;
    memcpy(to, edges, count * sizeof(edges[0]));
    edge_count = 0;
    return count;
}
uint64_t play_watchdog_us(void) { return gap_us(); }
int play_asserts(void) { return asserts; }
int play_notified_by(void) { return notified_by; }
void play_crystal(uint64_t takes_us) { crystal_takes_us = takes_us; }
void play_break_crystal(void) { crystal_runs_us = NEVER; }
int play_crystal_users(void) { return crystal.users + 100 * releases_without_request; }
uint64_t play_crystal_held_us(void) { return held_from_us; }
