/* What firmware/robot uses of Zephyr and nrfx, declared as there, so that its C can be checked without them: of Zephyr
 * 3.7 with nrfx 3.5, and of 4.3 with nrfx 3.14. Every header that it includes leads here, but crypto.h. What its macros
 * make can be found from outside, by played.c, which lives through a life of the application; nothing else is defined
 * here. Read where: nrfx's headers at the releases 3.6.0 (2024-07-26) and 3.10.0 (2025-01-21), between which nothing that
 * is used here differs, and its list of changes up to 3.14.0; Zephyr's at revisions of about 3.7 and 4.x and its guide
 * of migration to 4.3. Where a version matters, it and the file are named. */
#ifndef DECLARED_H
#define DECLARED_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

/* zephyr/version.h, of the version that west.yml pins */
#define ZEPHYR_VERSION(a, b, c) (((a) << 16) + ((b) << 8) + (c))
#ifndef ZEPHYR_VERSION_CODE
#define ZEPHYR_VERSION_CODE ZEPHYR_VERSION(3, 7, 0)
#endif

/* nrfx: templates/nrfx_config.h or Zephyr's modules/hal_nordic/nrfx/nrfx_config.h choose the version of its interface */
#ifndef NRFX_CONFIG_API_VER_MAJOR
#define NRFX_CONFIG_API_VER_MAJOR 3
#endif

/* zephyr/sys/util.h, toolchain.h */
#define ARRAY_SIZE(array) (sizeof(array) / sizeof((array)[0]))
#define BIT(n) (1UL << (n))
#define MIN(a, b) (((a) < (b)) ? (a) : (b))
#define BUILD_ASSERT(condition, text) _Static_assert(condition, text)

/* zephyr/devicetree.h: of the board in frogkick's overlay */
#define DT_NODELABEL(label) DT_##label
#define DECLARED_BARE(...) __VA_ARGS__
#define DECLARED_FOUR(node, property, function, separator, first) \
    function(node, property, first) DECLARED_BARE separator function(node, property, first + 1) DECLARED_BARE \
        separator function(node, property, first + 2) DECLARED_BARE separator function(node, property, first + 3)
#if defined(DECLARED_EIGHT_LIMBS)
#define DT_FOREACH_PROP_ELEM_SEP(node, property, function, separator) \
    DECLARED_FOUR(node, property, function, separator, 0) DECLARED_BARE separator \
        DECLARED_FOUR(node, property, function, separator, 4)
#else
#define DT_FOREACH_PROP_ELEM_SEP(node, property, function, separator) \
    DECLARED_FOUR(node, property, function, separator, 0)
#endif
#define DT_GPIO_PIN_BY_IDX(node, property, index) (22 + (index))
#define DT_IRQN(node) 10
#define DT_IRQ(node, cell) 1
extern uint8_t declared_flash[0x32000];
#define DT_REG_ADDR(node) ((uintptr_t)declared_flash)
#define DT_REG_SIZE(node) 0x32000
#define DT_MTD_FROM_FIXED_PARTITION(node) DT_flash_controller
#define DEVICE_DT_GET(node) (&declared_device)
struct device {
    const char *name;
};
extern const struct device declared_device;

/* zephyr/irq.h, nrfx_glue.h */
#define IRQ_CONNECT(line, priority, routine, parameter, flags) \
    declared_connect((line), (priority), (routine), (parameter), (flags))
void declared_connect(unsigned int line, unsigned int priority, void (*routine)(const void *),
                      void (*parameter)(void), uint32_t flags);
void nrfx_isr(const void *irq_handler);
unsigned int irq_lock(void);
void irq_unlock(unsigned int key);

/* zephyr/kernel.h */
#define __noinit __attribute__((section(".noinit")))
typedef struct {
    int64_t ticks;
} k_timeout_t;
k_timeout_t declared_usec(uint64_t microseconds);
#define K_USEC(t) declared_usec(t)
#define K_MSEC(t) declared_usec(1000u * (t))
#define K_FOREVER declared_usec(UINT64_MAX)
int32_t k_sleep(k_timeout_t timeout);
struct declared_thread {
    void (*entry)(void *, void *, void *);
    int priority;
};
#define K_PRIO_PREEMPT(x) (x)
#define K_THREAD_DEFINE(name, stack_size, function, p1, p2, p3, prio, options, delay) \
    const struct declared_thread declared_thread = {(function), (prio)}
extern const struct declared_thread declared_thread;
struct k_sem {
    unsigned int count;
};
#define K_SEM_DEFINE(name, initial, limit) struct k_sem name = {initial}
void k_sem_give(struct k_sem *sem);
int k_sem_take(struct k_sem *sem, k_timeout_t timeout);
struct k_work;
typedef void (*k_work_handler_t)(struct k_work *work);
struct k_work {
    k_work_handler_t handler;
};
#define K_WORK_DEFINE(work, function) struct k_work work = {function}
int k_work_submit(struct k_work *work);
int64_t k_uptime_get(void);
int64_t k_uptime_ticks(void);
uint64_t k_ticks_to_us_floor64(uint64_t t);

/* zephyr/sys */
typedef long atomic_t;
typedef long atomic_val_t;
bool atomic_cas(atomic_t *target, atomic_val_t old_value, atomic_val_t new_value);
atomic_val_t atomic_set(atomic_t *target, atomic_val_t value);
atomic_val_t atomic_get(const atomic_t *target);
atomic_val_t atomic_inc(atomic_t *target);
__attribute__((format(printf, 1, 2))) void printk(const char *fmt, ...);
struct ring_buf {
    uint8_t *buffer;
    uint32_t size;
};
#define RING_BUF_DECLARE(name, size8) \
    static uint8_t name##_bytes[size8]; \
    struct ring_buf name = {name##_bytes, size8}
uint32_t ring_buf_put(struct ring_buf *buf, const uint8_t *data, uint32_t size);
uint32_t ring_buf_get(struct ring_buf *buf, uint8_t *data, uint32_t size);
int settings_load(void);

/* zephyr/sys/notify.h, sys/onoff.h, drivers/clock_control/nrf_clock_control.h, nrfx hal/nrf_clock.h */
struct sys_notify {
    int state;
};
struct onoff_manager;
struct onoff_client {
    struct sys_notify notify;
};
void sys_notify_init_spinwait(struct sys_notify *notify);
int sys_notify_fetch_result(const struct sys_notify *notify, int *result);
int onoff_request(struct onoff_manager *mgr, struct onoff_client *cli);
int onoff_cancel_or_release(struct onoff_manager *mgr, struct onoff_client *cli);
typedef void *clock_control_subsys_t;
#define CLOCK_CONTROL_NRF_SUBSYS_HF ((clock_control_subsys_t)0)
struct onoff_manager *z_nrf_clock_control_get_onoff(clock_control_subsys_t sys);
typedef struct declared_clock NRF_CLOCK_Type;
#define NRF_CLOCK ((NRF_CLOCK_Type *)0)
typedef enum { NRF_CLOCK_HFCLK_LOW_ACCURACY, NRF_CLOCK_HFCLK_HIGH_ACCURACY } nrf_clock_hfclk_t;
typedef enum { NRF_CLOCK_DOMAIN_LFCLK, NRF_CLOCK_DOMAIN_HFCLK } nrf_clock_domain_t;
bool nrf_clock_is_running(const NRF_CLOCK_Type *p_reg, nrf_clock_domain_t domain, void *p_clk_src);

/* zephyr/drivers */
int flash_erase(const struct device *dev, off_t offset, size_t size);
int flash_write(const struct device *dev, off_t offset, const void *data, size_t len);
#define RESET_PIN BIT(0)
#define RESET_SOFTWARE BIT(1)
#define RESET_WATCHDOG BIT(4)
#define RESET_CPU_LOCKUP BIT(8)
ssize_t hwinfo_get_device_id(uint8_t *buffer, size_t length);
int hwinfo_get_reset_cause(uint32_t *cause);
int hwinfo_clear_reset_cause(void);
struct wdt_window {
    uint32_t min;
    uint32_t max;
};
struct wdt_timeout_cfg {
    struct wdt_window window;
    void (*callback)(const struct device *dev, int channel_id);
    uint8_t flags;
};
#define WDT_FLAG_RESET_SOC BIT(1)
#define WDT_OPT_PAUSE_HALTED_BY_DBG BIT(1)
int wdt_install_timeout(const struct device *dev, const struct wdt_timeout_cfg *cfg);
int wdt_setup(const struct device *dev, uint8_t options);
int wdt_feed(const struct device *dev, int channel_id);

/* zephyr/bluetooth */
struct bt_conn;
struct bt_uuid {
    uint8_t type;
};
#define BT_UUID_128_ENCODE(w32, w1, w2, w3, w48) \
    (uint8_t)((w48) >> 0), (uint8_t)((w48) >> 8), (uint8_t)((w48) >> 16), (uint8_t)((w48) >> 24), \
        (uint8_t)((w48) >> 32), (uint8_t)((w48) >> 40), (uint8_t)((w3) >> 0), (uint8_t)((w3) >> 8), \
        (uint8_t)((w2) >> 0), (uint8_t)((w2) >> 8), (uint8_t)((w1) >> 0), (uint8_t)((w1) >> 8), \
        (uint8_t)((w32) >> 0), (uint8_t)((w32) >> 8), (uint8_t)((w32) >> 16), (uint8_t)((w32) >> 24)
struct bt_uuid_128 {
    struct bt_uuid uuid;
    uint8_t val[16];
};
#define BT_UUID_DECLARE_128(...) ((const struct bt_uuid *)&(const struct bt_uuid_128){{2}, {__VA_ARGS__}})
struct bt_data {
    uint8_t type;
    uint8_t data_len;
    const uint8_t *data;
};
#define BT_DATA(kind, bytes, length) {.type = (kind), .data_len = (uint8_t)(length), .data = (const uint8_t *)(bytes)}
#define BT_DATA_BYTES(kind, ...) \
    BT_DATA(kind, ((const uint8_t[]){__VA_ARGS__}), sizeof((const uint8_t[]){__VA_ARGS__}))
#define BT_DATA_FLAGS 0x01
#define BT_DATA_UUID128_ALL 0x07
#define BT_DATA_NAME_COMPLETE 0x09
#define BT_LE_AD_GENERAL 0x02
#define BT_LE_AD_NO_BREDR 0x04
#if ZEPHYR_VERSION_CODE < ZEPHYR_VERSION(4, 0, 0)
#define BT_LE_ADV_OPT_CONNECTABLE BIT(0)
#define BT_LE_ADV_OPT_ONE_TIME BIT(1)
#else
#define BT_LE_ADV_OPT_CONN (BIT(0) | BIT(1))
#endif
#define BT_GAP_ADV_FAST_INT_MIN_2 0x00a0
#define BT_GAP_ADV_FAST_INT_MAX_2 0x00f0
typedef struct bt_addr_le bt_addr_le_t;
struct bt_le_adv_param {
    uint32_t options;
    uint32_t interval_min;
    uint32_t interval_max;
    const bt_addr_le_t *peer;
};
#define BT_LE_ADV_PARAM(options, minimum, maximum, peer) \
    (&(const struct bt_le_adv_param){(options), (minimum), (maximum), (peer)})
#define BT_ID_DEFAULT 0
int bt_enable(void (*ready)(int err));
int bt_le_adv_start(const struct bt_le_adv_param *param, const struct bt_data *ad, size_t ad_len,
                    const struct bt_data *sd, size_t sd_len);
struct bt_bond_info {
    const bt_addr_le_t *addr;
};
void bt_foreach_bond(uint8_t id, void (*func)(const struct bt_bond_info *info, void *user_data), void *user_data);

/* An enum since before 3.7: conn.h. */
enum __attribute__((packed)) bt_conn_type { BT_CONN_TYPE_LE = 1 };
enum bt_conn_state { BT_CONN_STATE_DISCONNECTED, BT_CONN_STATE_CONNECTED };
struct bt_conn_info {
    uint8_t type;
    enum bt_conn_state state;
};
typedef enum __attribute__((packed)) {
    BT_SECURITY_L0, BT_SECURITY_L1, BT_SECURITY_L2, BT_SECURITY_L3, BT_SECURITY_L4
} bt_security_t;
bt_security_t bt_conn_get_security(const struct bt_conn *conn);
#define BT_HCI_ERR_AUTH_FAIL 0x05 /* hci_types.h */
int bt_conn_disconnect(struct bt_conn *conn, uint8_t reason);
int bt_conn_get_info(const struct bt_conn *conn, struct bt_conn_info *info);
struct bt_conn *bt_conn_ref(struct bt_conn *conn);
void bt_conn_unref(struct bt_conn *conn);
void bt_conn_foreach(enum bt_conn_type type, void (*func)(struct bt_conn *conn, void *data), void *data);
struct bt_conn_cb {
    void (*connected)(struct bt_conn *conn, uint8_t err);
    void (*disconnected)(struct bt_conn *conn, uint8_t reason);
    void (*recycled)(void);
};
extern const struct bt_conn_cb declared_conn_cb;
#define BT_CONN_CB_DEFINE(name) const struct bt_conn_cb declared_conn_cb
enum bt_security_err { BT_SECURITY_ERR_SUCCESS, BT_SECURITY_ERR_PAIR_NOT_ALLOWED };
struct bt_conn_pairing_feat {
    uint8_t io_capability;
};
struct bt_conn_auth_cb {
    enum bt_security_err (*pairing_accept)(struct bt_conn *conn, const struct bt_conn_pairing_feat *const feat);
    void (*passkey_display)(struct bt_conn *conn, unsigned int passkey);
    void (*cancel)(struct bt_conn *conn);
#if defined(CONFIG_BT_APP_PASSKEY) /* from 4.3 on: conn.h */
    uint32_t (*app_passkey)(struct bt_conn *conn);
#endif
};
int bt_conn_auth_cb_register(const struct bt_conn_auth_cb *cb);
struct bt_conn_auth_info_cb {
    void (*pairing_complete)(struct bt_conn *conn, bool bonded);
    void (*pairing_failed)(struct bt_conn *conn, enum bt_security_err reason);
};
int bt_conn_auth_info_cb_register(struct bt_conn_auth_info_cb *cb);
#if ZEPHYR_VERSION_CODE >= ZEPHYR_VERSION(4, 3, 0) /* deprecated there: conn.h, guide of migration to 4.3 */
__attribute__((deprecated))
#endif
int bt_passkey_set(unsigned int passkey);

struct bt_gatt_attr;
typedef ssize_t (*bt_gatt_attr_read_func_t)(struct bt_conn *conn, const struct bt_gatt_attr *attr, void *buf,
                                            uint16_t len, uint16_t offset);
typedef ssize_t (*bt_gatt_attr_write_func_t)(struct bt_conn *conn, const struct bt_gatt_attr *attr, const void *buf,
                                             uint16_t len, uint16_t offset, uint8_t flags);
struct bt_gatt_attr {
    const struct bt_uuid *uuid;
    bt_gatt_attr_read_func_t read;
    bt_gatt_attr_write_func_t write;
    void *user_data;
    uint16_t perm;
};
struct bt_gatt_service_static {
    const struct bt_gatt_attr *attrs;
    size_t attr_count;
};
#define BT_GATT_PERM_NONE 0
#define BT_GATT_PERM_READ BIT(0)
#define BT_GATT_PERM_WRITE BIT(1)
#define BT_GATT_PERM_READ_AUTHEN BIT(4)
#define BT_GATT_PERM_WRITE_AUTHEN BIT(5)
#define BT_GATT_CHRC_WRITE_WITHOUT_RESP 0x04
#define BT_GATT_CHRC_WRITE 0x08
#define BT_GATT_CHRC_NOTIFY 0x10
#define BT_ATT_ERR_INVALID_OFFSET 0x07
#define BT_GATT_ERR(error) (-(error))
#define BT_GATT_PRIMARY_SERVICE(service) {.uuid = (service)}
#define BT_GATT_CHARACTERISTIC(id, properties, permissions, reader, writer, value) \
    {.perm = (uint16_t)(properties)}, \
    { \
        .uuid = (id), .read = (reader), .write = (writer), .user_data = (value), .perm = (uint16_t)(permissions) \
    }
#define BT_GATT_CCC(changed, permissions) {.perm = (uint16_t)(permissions), .user_data = (changed)}
#define BT_GATT_SERVICE_DEFINE(name, ...) \
    static const struct bt_gatt_attr name##_attributes[] = {__VA_ARGS__}; \
    const struct bt_gatt_attr *const declared_attributes = name##_attributes; \
    static const struct bt_gatt_service_static name = {name##_attributes, ARRAY_SIZE(name##_attributes)}
extern const struct bt_gatt_attr *const declared_attributes;
uint16_t bt_gatt_get_mtu(struct bt_conn *conn);
int bt_gatt_notify(struct bt_conn *conn, const struct bt_gatt_attr *attr, const void *data, uint16_t len);

/* hal/nrf_saadc.h */
typedef struct {
    uint32_t TASKS_START;
} NRF_SAADC_Type;
#define NRF_SAADC ((NRF_SAADC_Type *)0x40007000UL)
typedef void nrf_saadc_value_t; /* since nrfx 3.2; uint16_t before */
typedef enum { NRF_SAADC_RESOLUTION_12BIT = 2 } nrf_saadc_resolution_t;
typedef enum { NRF_SAADC_INPUT_DISABLED = 0, NRF_SAADC_INPUT_AIN0 = 1 } nrf_saadc_input_t;
typedef enum { NRF_SAADC_RESISTOR_DISABLED } nrf_saadc_resistor_t;
typedef enum { NRF_SAADC_GAIN1_6 } nrf_saadc_gain_t;
typedef enum { NRF_SAADC_REFERENCE_INTERNAL } nrf_saadc_reference_t;
typedef enum { NRF_SAADC_ACQTIME_40US = 5 } nrf_saadc_acqtime_t;
typedef enum { NRF_SAADC_MODE_SINGLE_ENDED } nrf_saadc_mode_t;
typedef enum { NRF_SAADC_BURST_DISABLED } nrf_saadc_burst_t;
typedef enum { NRF_SAADC_TASK_START = 0, NRF_SAADC_TASK_SAMPLE = 4 } nrf_saadc_task_t;
typedef enum { NRF_SAADC_EVENT_END = 0x104 } nrf_saadc_event_t;
typedef struct {
    nrf_saadc_resistor_t resistor_p;
    nrf_saadc_resistor_t resistor_n;
    nrf_saadc_gain_t gain;
    nrf_saadc_reference_t reference;
    nrf_saadc_acqtime_t acq_time;
    nrf_saadc_mode_t mode;
    nrf_saadc_burst_t burst;
} nrf_saadc_channel_config_t;
void nrf_saadc_channel_init(NRF_SAADC_Type *p_reg, uint8_t channel, const nrf_saadc_channel_config_t *config);
void nrf_saadc_channel_input_set(NRF_SAADC_Type *p_reg, uint8_t channel, nrf_saadc_input_t pselp, nrf_saadc_input_t pseln);
void nrf_saadc_resolution_set(NRF_SAADC_Type *p_reg, nrf_saadc_resolution_t resolution);
void nrf_saadc_buffer_init(NRF_SAADC_Type *p_reg, nrf_saadc_value_t *p_buffer, uint32_t size);
void nrf_saadc_enable(NRF_SAADC_Type *p_reg);
void nrf_saadc_task_trigger(NRF_SAADC_Type *p_reg, nrf_saadc_task_t task);
bool nrf_saadc_event_check(const NRF_SAADC_Type *p_reg, nrf_saadc_event_t event);
void nrf_saadc_event_clear(NRF_SAADC_Type *p_reg, nrf_saadc_event_t event);

/* nrfx: nrfx_gpiote.h, nrfx_timer.h, nrfx_power.h, nrfx_gppi.h, the same from 3.2 to 3.14 */
typedef enum { NRFX_SUCCESS = 0x0BAD0000, NRFX_ERROR_NO_MEM } nrfx_err_t;
typedef uint32_t nrfx_gpiote_pin_t;
typedef enum { NRF_GPIO_PIN_S0S1 } nrf_gpio_pin_drive_t;
typedef enum { NRF_GPIO_PIN_INPUT_DISCONNECT } nrf_gpio_pin_input_t;
typedef enum { NRF_GPIO_PIN_NOPULL } nrf_gpio_pin_pull_t;
typedef enum { NRF_GPIOTE_POLARITY_NONE, NRF_GPIOTE_POLARITY_TOGGLE } nrf_gpiote_polarity_t;
typedef enum { NRF_GPIOTE_INITIAL_VALUE_LOW, NRF_GPIOTE_INITIAL_VALUE_HIGH } nrf_gpiote_outinit_t;
typedef struct {
    uint8_t drv_inst_idx;
} nrfx_gpiote_t;
typedef struct {
    nrf_gpio_pin_drive_t drive;
    nrf_gpio_pin_input_t input_connect;
    nrf_gpio_pin_pull_t pull;
} nrfx_gpiote_output_config_t;
typedef struct {
    uint8_t task_ch;
    nrf_gpiote_polarity_t polarity;
    nrf_gpiote_outinit_t init_val;
} nrfx_gpiote_task_config_t;
#define NRFX_GPIOTE_INSTANCE(id) {id}
bool nrfx_gpiote_init_check(const nrfx_gpiote_t *instance);
nrfx_err_t nrfx_gpiote_init(const nrfx_gpiote_t *instance, uint8_t interrupt_priority);
nrfx_err_t nrfx_gpiote_channel_alloc(const nrfx_gpiote_t *instance, uint8_t *channel);
nrfx_err_t nrfx_gpiote_output_configure(const nrfx_gpiote_t *instance, nrfx_gpiote_pin_t pin,
                                        const nrfx_gpiote_output_config_t *config,
                                        const nrfx_gpiote_task_config_t *task_config);
void nrfx_gpiote_out_task_enable(const nrfx_gpiote_t *instance, nrfx_gpiote_pin_t pin);
void nrfx_gpiote_clr_task_trigger(const nrfx_gpiote_t *instance, nrfx_gpiote_pin_t pin);
uint32_t nrfx_gpiote_clr_task_address_get(const nrfx_gpiote_t *instance, nrfx_gpiote_pin_t pin);
uint32_t nrfx_gpiote_set_task_address_get(const nrfx_gpiote_t *instance, nrfx_gpiote_pin_t pin);

typedef enum { NRF_TIMER_EVENT_COMPARE0 = 0x140, NRF_TIMER_EVENT_COMPARE1 = 0x144 } nrf_timer_event_t;
typedef enum { NRF_TIMER_CC_CHANNEL0, NRF_TIMER_CC_CHANNEL1 } nrf_timer_cc_channel_t;
typedef enum { NRF_TIMER_BIT_WIDTH_16, NRF_TIMER_BIT_WIDTH_32 = 3 } nrf_timer_bit_width_t;
typedef enum {
    NRF_TIMER_SHORT_COMPARE0_CLEAR_MASK = 1 << 0,
    NRF_TIMER_SHORT_COMPARE0_STOP_MASK = 1 << 8
} nrf_timer_short_mask_t;
typedef struct {
    uint8_t instance_id;
} nrfx_timer_t;
typedef struct {
    uint32_t frequency;
    nrf_timer_bit_width_t bit_width;
} nrfx_timer_config_t;
typedef void (*nrfx_timer_event_handler_t)(nrf_timer_event_t event_type, void *context);
#define NRFX_TIMER_INSTANCE(id) {id}
#define NRFX_TIMER_DEFAULT_CONFIG(base_frequency) {(base_frequency), NRF_TIMER_BIT_WIDTH_16}
nrfx_err_t nrfx_timer_init(const nrfx_timer_t *instance, const nrfx_timer_config_t *config,
                           nrfx_timer_event_handler_t handler);
void nrfx_timer_enable(const nrfx_timer_t *instance);
void nrfx_timer_disable(const nrfx_timer_t *instance);
void nrfx_timer_clear(const nrfx_timer_t *instance);
void nrfx_timer_compare(const nrfx_timer_t *instance, nrf_timer_cc_channel_t channel, uint32_t value,
                        bool enable_int);
void nrfx_timer_extended_compare(const nrfx_timer_t *instance, nrf_timer_cc_channel_t channel, uint32_t value,
                                 nrf_timer_short_mask_t shorts, bool enable_int);
uint32_t nrfx_timer_compare_event_address_get(const nrfx_timer_t *instance, uint32_t channel);
void nrfx_timer_2_irq_handler(void);

typedef enum { NRF_POWER_POFTHR_V27 = 14 } nrf_power_pof_thr_t;
typedef struct {
    uint32_t POFCON;
} NRF_POWER_Type;
#define NRF_POWER ((NRF_POWER_Type *)0x40000000UL)
void nrf_power_pofcon_set(NRF_POWER_Type *p_reg, bool enabled, nrf_power_pof_thr_t thr);
typedef struct {
    void (*handler)(void);
    nrf_power_pof_thr_t thr;
} nrfx_power_pofwarn_config_t;
void nrfx_power_pof_init(const nrfx_power_pofwarn_config_t *p_config);
void nrfx_power_pof_enable(const nrfx_power_pofwarn_config_t *p_config);

nrfx_err_t nrfx_gppi_channel_alloc(uint8_t *channel);
void nrfx_gppi_channel_endpoints_setup(uint8_t channel, uint32_t eep, uint32_t tep);
void nrfx_gppi_fork_endpoint_setup(uint8_t channel, uint32_t fork_tep);
void nrfx_gppi_channels_enable(uint32_t mask);
void nrfx_gppi_channels_disable(uint32_t mask);

#endif
