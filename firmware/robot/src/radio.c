#include "radio.h"

#include <errno.h>
#include <zephyr/bluetooth/bluetooth.h>
#include <zephyr/bluetooth/conn.h>
#include <zephyr/bluetooth/gatt.h>
#include <zephyr/bluetooth/hci.h>
#include <zephyr/bluetooth/uuid.h>
#include <zephyr/drivers/hwinfo.h>
#include <zephyr/kernel.h>
#include <zephyr/settings/settings.h>
#include <zephyr/sys/atomic.h>
#include <zephyr/sys/printk.h>
#include <zephyr/sys/ring_buffer.h>
#include <zephyr/sys/util.h>
#include <zephyr/version.h>

#define RECEIVE_BYTES 1536 /* six frames, of 240 bytes at most; what arrives while a decision computes waits here */
#define ATT_HEAD_BYTES 3u

/* The thread that sends has a lower priority than the loop, which it must not hold up. It waits for the radio's
 * buffers, which become free one by one, or all at once when the connection ends. */
#define SENDER_STACK_BYTES 1280 /* twice what it uses, by static figures: 640 bytes */
#define SENDER_PRIORITY K_PRIO_PREEMPT(5)
#define RETRY_MS 10
#define PAIRINGS_MAX 3u
#define UNPAIRED_S 60  /* the only connection is not for a host that never pairs; its user may look for the passkey so long */
#define TRIES_MAX 500u /* 5 s without a buffer: the frame is dropped */

#define NUS_SERVICE BT_UUID_128_ENCODE(0x6e400001, 0xb5a3, 0xf393, 0xe0a9, 0xe50e24dcca9e)
#define NUS_RECEIVE BT_UUID_128_ENCODE(0x6e400002, 0xb5a3, 0xf393, 0xe0a9, 0xe50e24dcca9e)
#define NUS_TRANSMIT BT_UUID_128_ENCODE(0x6e400003, 0xb5a3, 0xf393, 0xe0a9, 0xe50e24dcca9e)

#if defined(CONFIG_FROGKICK_OPEN_LINK)
#define WRITE_PERMISSION BT_GATT_PERM_WRITE
#define SUBSCRIBE_PERMISSION (BT_GATT_PERM_READ | BT_GATT_PERM_WRITE)
#else
#define WRITE_PERMISSION BT_GATT_PERM_WRITE_AUTHEN
#define SUBSCRIBE_PERMISSION (BT_GATT_PERM_READ_AUTHEN | BT_GATT_PERM_WRITE_AUTHEN)
#endif

RING_BUF_DECLARE(received, RECEIVE_BYTES);
static void (*tell_arrival)(void);
static atomic_t dropped;
static atomic_t dropped_frames;
static atomic_t connected_s; /* 1 + the time at which the host connected; 0: none has, or it is known to have paired */

static uint8_t outgoing[FK_RADIO_SEND_BYTES];
static uint32_t outgoing_bytes;
static atomic_t is_sending; /* 1: the buffer `outgoing` belongs to the thread */
static K_SEM_DEFINE(to_send, 0, 1);

/* Bytes that find no room are lost: their frame fails its CRC-32, and the host repeats it. */
static ssize_t on_write(struct bt_conn *conn, const struct bt_gatt_attr *attribute, const void *bytes, uint16_t length,
                        uint16_t offset, uint8_t flags)
{
    (void)conn;
    (void)attribute;
    (void)flags;
    if (offset != 0) {
        return BT_GATT_ERR(BT_ATT_ERR_INVALID_OFFSET);
    }
    (void)ring_buf_put(&received, bytes, length);
    tell_arrival();
    return length;
}

BT_GATT_SERVICE_DEFINE(nus, BT_GATT_PRIMARY_SERVICE(BT_UUID_DECLARE_128(NUS_SERVICE)),
                       BT_GATT_CHARACTERISTIC(BT_UUID_DECLARE_128(NUS_TRANSMIT), BT_GATT_CHRC_NOTIFY,
                                              BT_GATT_PERM_NONE, NULL, NULL, NULL),
                       BT_GATT_CCC(NULL, SUBSCRIBE_PERMISSION),
                       BT_GATT_CHARACTERISTIC(BT_UUID_DECLARE_128(NUS_RECEIVE),
                                              BT_GATT_CHRC_WRITE | BT_GATT_CHRC_WRITE_WITHOUT_RESP, WRITE_PERMISSION,
                                              NULL, on_write, NULL));
#define TRANSMIT_VALUE (&nus.attrs[2])

static const struct bt_data advertised[] = {
    BT_DATA_BYTES(BT_DATA_FLAGS, BT_LE_AD_GENERAL | BT_LE_AD_NO_BREDR),
    BT_DATA_BYTES(BT_DATA_UUID128_ALL, NUS_SERVICE),
};
static const struct bt_data scan_answer[] = {
    BT_DATA(BT_DATA_NAME_COMPLETE, CONFIG_BT_DEVICE_NAME, sizeof(CONFIG_BT_DEVICE_NAME) - 1),
};

/* Advertise until a host connects. Zephyr 4.0 has one option for what were two. */
#if ZEPHYR_VERSION_CODE >= ZEPHYR_VERSION(4, 0, 0)
#define ADVERTISE_ONCE BT_LE_ADV_OPT_CONN
#else
#define ADVERTISE_ONCE (BT_LE_ADV_OPT_CONNECTABLE | BT_LE_ADV_OPT_ONE_TIME)
#endif

static void advertise(struct k_work *work)
{
    (void)work;
    const int error = bt_le_adv_start(BT_LE_ADV_PARAM(ADVERTISE_ONCE, BT_GAP_ADV_FAST_INT_MIN_2,
                                                      BT_GAP_ADV_FAST_INT_MAX_2, NULL),
                                      advertised, ARRAY_SIZE(advertised), scan_answer, ARRAY_SIZE(scan_answer));
    if (error != 0 && error != -EALREADY) {
        printk("no advertising: error %d\n", error);
    }
}
static K_WORK_DEFINE(advertise_work, advertise);

static void on_recycled(void)
{
    (void)k_work_submit(&advertise_work); /* the connection is free again: only now may advertising start */
}

static void on_connected(struct bt_conn *conn, uint8_t error)
{
    (void)conn;
    if (error == 0) {
        atomic_set(&connected_s, (atomic_val_t)(k_uptime_get() / 1000) + 1);
    }
}

static void on_disconnected(struct bt_conn *conn, uint8_t reason)
{
    (void)conn;
    (void)reason;
    atomic_set(&connected_s, 0);
    atomic_set(&dropped, 1);
    tell_arrival();
}

BT_CONN_CB_DEFINE(connection) = {.connected = on_connected, .disconnected = on_disconnected, .recycled = on_recycled};

static void find(struct bt_conn *conn, void *found)
{
    struct bt_conn_info info;

    if (bt_conn_get_info(conn, &info) == 0 && info.state == BT_CONN_STATE_CONNECTED) {
        *(struct bt_conn **)found = bt_conn_ref(conn);
    }
}

#if !defined(CONFIG_FROGKICK_OPEN_LINK)
static void count_bond(const struct bt_bond_info *bond, void *count)
{
    (void)bond;
    ++*(uint32_t *)count;
}

static int32_t is_after_power_on;
static uint32_t pairings_tried; /* since one succeeded; an interrupted one counts too */

/* FROGKICK_PAIRING_S in Kconfig says why. Each failed try reveals one bit of a passkey that never changes: twenty
 * tries find it. */
static enum bt_security_err on_pairing(struct bt_conn *conn, const struct bt_conn_pairing_feat *const feat)
{
    uint32_t bonds = 0;

    (void)conn;
    (void)feat;
    bt_foreach_bond(BT_ID_DEFAULT, count_bond, &bonds);
    if (is_after_power_on == 0 || pairings_tried >= PAIRINGS_MAX ||
        (bonds != 0 && k_uptime_get() >= 1000 * CONFIG_FROGKICK_PAIRING_S)) {
        return BT_SECURITY_ERR_PAIR_NOT_ALLOWED;
    }
    ++pairings_tried;
    return BT_SECURITY_ERR_SUCCESS;
}

static void on_paired(struct bt_conn *conn, bool bonded)
{
    (void)conn;
    (void)bonded;
    pairings_tried = 0;
}

static struct bt_conn_auth_info_cb outcome = {
    .pairing_complete = on_paired,
};

static void on_passkey(struct bt_conn *conn, unsigned int passkey)
{
    (void)conn;
    (void)passkey; /* no display; it was printed at start */
}

static void on_cancel(struct bt_conn *conn)
{
    (void)conn;
}

static unsigned int passkey(void)
{
    uint8_t serial[8] = {0};
    uint32_t hash = 2166136261u; /* FNV-1a */

    if (CONFIG_FROGKICK_PASSKEY != 0) {
        return CONFIG_FROGKICK_PASSKEY;
    }
    (void)hwinfo_get_device_id(serial, sizeof(serial));
    for (uint32_t index = 0; index < sizeof(serial); ++index) {
        hash = (hash ^ serial[index]) * 16777619u;
    }
    return hash % 1000000u;
}

/* Zephyr asks for the passkey from 4.3 on; before, it is told once. Kconfig chooses. */
#if defined(CONFIG_BT_APP_PASSKEY)
static uint32_t on_passkey_wanted(struct bt_conn *conn)
{
    (void)conn;
    return passkey();
}
#endif

/* The core's loop calls it at each turn, several times a second. */
static void drop_unpaired(void)
{
    const atomic_val_t since_s = atomic_get(&connected_s);
    struct bt_conn *conn = NULL;

    if (since_s == 0 || (atomic_val_t)(k_uptime_get() / 1000) - since_s < UNPAIRED_S) {
        return;
    }
    atomic_set(&connected_s, 0);
    bt_conn_foreach(BT_CONN_TYPE_LE, find, &conn);
    if (conn != NULL) {
        if (bt_conn_get_security(conn) < BT_SECURITY_L3) { /* which the service asks for */
            (void)bt_conn_disconnect(conn, BT_HCI_ERR_AUTH_FAIL);
        }
        bt_conn_unref(conn);
    }
}

static const struct bt_conn_auth_cb authentication = {
    .pairing_accept = on_pairing,
    .passkey_display = on_passkey,
    .cancel = on_cancel,
#if defined(CONFIG_BT_APP_PASSKEY)
    .app_passkey = on_passkey_wanted,
#endif
};

static int32_t secure(void)
{
    printk("passkey %06u\n", passkey());
#if !defined(CONFIG_BT_APP_PASSKEY)
    const int error = bt_passkey_set(passkey());
    if (error != 0) {
        return error;
    }
#endif
    const int told = bt_conn_auth_info_cb_register(&outcome);
    return (told != 0) ? told : bt_conn_auth_cb_register(&authentication);
}
#else
static int32_t secure(void)
{
    printk("the link is open: anybody near can arm this robot\n");
    return 0;
}
#endif

int32_t fk_radio_init(void (*arrived)(void), int32_t after_power_on)
{
    tell_arrival = arrived;
#if !defined(CONFIG_FROGKICK_OPEN_LINK)
    is_after_power_on = after_power_on;
#else
    (void)after_power_on;
#endif
    int32_t error = bt_enable(NULL);
    if (error == 0) {
        error = settings_load(); /* bonds */
    }
    if (error == 0) {
        error = secure();
    }
    if (error == 0) {
        advertise(NULL);
    }
    return error;
}

int32_t fk_radio_read(uint8_t *byte)
{
    return (ring_buf_get(&received, byte, 1) == 1) ? 1 : 0;
}

int32_t fk_radio_take_drop(void)
{
#if !defined(CONFIG_FROGKICK_OPEN_LINK)
    drop_unpaired();
#endif
    return (int32_t)atomic_set(&dropped, 0);
}

/* bt_gatt_notify waits for a buffer as long as the connection lasts, or returns an error where there is none. */
static int notify(struct bt_conn *conn, const uint8_t *bytes, uint32_t length)
{
    int error = bt_gatt_notify(conn, TRANSMIT_VALUE, bytes, (uint16_t)length);

    for (uint32_t tries = 1; error == -ENOMEM && tries < TRIES_MAX; ++tries) {
        (void)k_sleep(K_MSEC(RETRY_MS));
        error = bt_gatt_notify(conn, TRANSMIT_VALUE, bytes, (uint16_t)length);
    }
    return error;
}

/* @retval 0, or a negative errno: none of the frame was sent, or a part, which the next call ends with a delimiter */
static int send_frame(struct bt_conn *conn, const uint8_t *bytes, uint32_t length)
{
    static const uint8_t delimiter = 0;
    static uint8_t is_torn; /* 1: the host has received a part of a frame that will not be completed */
    uint32_t sent = 0;
    int error = is_torn != 0 ? notify(conn, &delimiter, sizeof(delimiter)) : 0;

    if (error != 0) {
        return error;
    }
    is_torn = 0;
    while (error == 0 && sent < length) {
        const uint32_t mtu = bt_gatt_get_mtu(conn); /* 23 at least, 0 once the connection has ended */
        const uint32_t part = (mtu > ATT_HEAD_BYTES) ? MIN(length - sent, mtu - ATT_HEAD_BYTES) : 0;

        error = (part > 0) ? notify(conn, bytes + sent, part) : -ENOTCONN;
        sent += (error == 0) ? part : 0;
    }
    is_torn = error != 0 && sent > 0;
    return error;
}

static void send_frames(void)
{
    struct bt_conn *conn = NULL;
    uint32_t begin = 0;

    /* The reference is held until all is sent, so that no other connection can replace this one. */
    bt_conn_foreach(BT_CONN_TYPE_LE, find, &conn);
    while (begin < outgoing_bytes) {
        uint32_t end = begin;
        while (end < outgoing_bytes && outgoing[end] != 0) {
            ++end;
        }
        end += (end < outgoing_bytes) ? 1 : 0; /* with its delimiter */
        if (conn == NULL || send_frame(conn, outgoing + begin, end - begin) != 0) {
            (void)atomic_inc(&dropped_frames);
        }
        begin = end;
    }
    if (conn != NULL) {
        bt_conn_unref(conn);
    }
}

static void send_for_ever(void *first, void *second, void *third)
{
    (void)first;
    (void)second;
    (void)third;
    for (;;) {
        (void)k_sem_take(&to_send, K_FOREVER);
        send_frames();
        (void)atomic_set(&is_sending, 0);
        tell_arrival();
    }
}
K_THREAD_DEFINE(sender, SENDER_STACK_BYTES, send_for_ever, NULL, NULL, NULL, SENDER_PRIORITY, 0, 0);

int32_t fk_radio_is_sending(void)
{
    return (atomic_get(&is_sending) != 0) ? 1 : 0;
}

uint8_t *fk_radio_send_buffer(void)
{
    return outgoing;
}

void fk_radio_send(uint32_t length)
{
    outgoing_bytes = length;
    (void)atomic_set(&is_sending, 1);
    k_sem_give(&to_send);
}

uint32_t fk_radio_take_dropped_frames(void)
{
    return (uint32_t)atomic_set(&dropped_frames, 0);
}
