/* Bluetooth: one connection. A notification holds a buffer from the call until the host has taken it, at the next
 * connection event of a link that is not faded. Without a free buffer the call waits, as bt_att_create_pdu does. */
#include <errno.h>
#include <string.h>

#include "played.h"

#define CONNECTION_INTERVAL_US 15000u
#define BUFFERS_MAX 16
#define SENT_MAX 65536

struct bt_conn {
    int nothing;
};
static struct bt_conn the_conn;
static uint32_t bonds;
static const struct bt_conn_auth_cb *authentication;
static struct bt_conn_auth_info_cb *outcome;
static int is_connected;
static bt_security_t security = BT_SECURITY_L4;
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
static struct k_sem buffer_free;

int bt_enable(void (*)(int err)) { return 0; }
int bt_le_adv_start(const struct bt_le_adv_param *, const struct bt_data *, size_t, const struct bt_data *, size_t)
{
    return 0;
}
void bt_foreach_bond(uint8_t id, void (*func)(const struct bt_bond_info *info, void *user_data), void *user_data)
{
    static const struct bt_bond_info bond;
    (void)id;
    for (uint32_t i = 0; i < bonds; ++i) {
        func(&bond, user_data);
    }
}
int bt_conn_get_info(const struct bt_conn *, struct bt_conn_info *info)
{
    info->state = is_connected ? BT_CONN_STATE_CONNECTED : BT_CONN_STATE_DISCONNECTED;
    return 0;
}
bt_security_t bt_conn_get_security(const struct bt_conn *) { return security; }
void play_disconnect(void);
int bt_conn_disconnect(struct bt_conn *, uint8_t)
{
    play_disconnect();
    return 0;
}
struct bt_conn *bt_conn_ref(struct bt_conn *conn) { return conn; }
void bt_conn_unref(struct bt_conn *) {}
void bt_conn_foreach(enum bt_conn_type, void (*func)(struct bt_conn *conn, void *data), void *data)
{
    if (is_connected) {
        func(&the_conn, data);
    }
}
int bt_conn_auth_cb_register(const struct bt_conn_auth_cb *cb)
{
    authentication = cb;
    return 0;
}
int bt_conn_auth_info_cb_register(struct bt_conn_auth_info_cb *cb)
{
    outcome = cb;
    return 0;
}
/* A host that is not bonded pairs; with the right passkey it is bonded then. 1: it was let. */
int play_pair(int right)
{
    static const struct bt_conn_pairing_feat feat;
    if (authentication->pairing_accept(&the_conn, &feat) != BT_SECURITY_ERR_SUCCESS) {
        return 0;
    }
    bonds += right ? 1u : 0u;
    if (right) {
        outcome->pairing_complete(&the_conn, true);
    } else if (outcome->pairing_failed != NULL) {
        outcome->pairing_failed(&the_conn, BT_SECURITY_ERR_PAIR_NOT_ALLOWED);
    }
    return 1;
}
int bt_passkey_set(unsigned int) { return 0; }
uint16_t bt_gatt_get_mtu(struct bt_conn *) { return mtu; }

int bt_gatt_notify(struct bt_conn *, const struct bt_gatt_attr *attr, const void *data, uint16_t len)
{
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

uint64_t played_radio_next_us(void) { return interval_us; }
void played_radio_event(void)
{
    if (now_us != interval_us) {
        return;
    }
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

void play_connect(int subscribed)
{
    is_connected = 1;
    is_subscribed = subscribed;
    is_faded = 0;
    interval_us = now_us + CONNECTION_INTERVAL_US;
    declared_conn_cb.connected(&the_conn, 0);
}
void play_security(int level) { security = (bt_security_t)level; }
int play_is_connected(void) { return is_connected; }
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
void play_fade(int faded) { is_faded = faded; }
void play_mtu(uint32_t bytes) { mtu = (uint16_t)bytes; }
