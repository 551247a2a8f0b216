#include "fk_auth.h"

#define LABEL_BYTES 16u

static const uint8_t of_robot[LABEL_BYTES] = {'f', 'r', 'o', 'g', 'k', 'i', 'c', 'k', ' ', 'r', 'o', 'b', 'o', 't', 0u, 0u};
static const uint8_t of_command[LABEL_BYTES] = {'f', 'r', 'o', 'g', 'k', 'i', 'c', 'k',
                                                ' ', 'c', 'o', 'm', 'm', 'a', 'n', 'd'};
static const uint8_t of_nonce[LABEL_BYTES] = {'f', 'r', 'o', 'g', 'k', 'i', 'c', 'k', ' ', 'n', 'o', 'n', 'c', 'e', 0u, 0u};

static void copy(uint8_t *to, const uint8_t *from, uint32_t count)
{
    for (uint32_t i = 0u; i < count; ++i) {
        to[i] = from[i];
    }
}

void fk_auth_init(fk_auth_t *auth)
{
    auth->nonces = 0u;
    auth->is_seeded = 0u;
    fk_auth_end(auth);
}

void fk_auth_end(fk_auth_t *auth)
{
    auth->has_pending = 0u;
    auth->has_current = 0u;
}

int32_t fk_auth_seed(fk_auth_t *auth)
{
    if (auth->is_seeded == 0u && fk_port_random(auth->seed, sizeof(auth->seed)) == 0) {
        auth->is_seeded = 1u;
    }
    return (auth->is_seeded != 0u) ? 1 : 0;
}

/* HMAC(key, label nonces): of `count` bytes of nonces */
static void derive(const uint8_t *key, const uint8_t *label, const uint8_t *nonces, uint32_t count,
                   uint8_t code[FK_SHA256_BYTES])
{
    fk_hmac_t hmac;
    fk_hmac_begin(&hmac, key);
    fk_hmac_add(&hmac, label, LABEL_BYTES);
    fk_hmac_add(&hmac, nonces, count);
    fk_hmac_end(&hmac, code);
}

static int32_t is_fresh(const fk_auth_t *auth, uint64_t now_us)
{
    return auth->has_pending != 0u && now_us - auth->made_us < FK_AUTH_FRESH_US;
}

int32_t fk_auth_answer(fk_auth_t *auth, const uint32_t key[FK_AUTH_KEY_WORDS],
                       const uint8_t host_nonce[FK_AUTH_NONCE_BYTES], uint64_t now_us,
                       uint8_t proof[FK_AUTH_PROOF_BYTES])
{
    uint8_t key_bytes[FK_AUTH_KEY_BYTES];
    uint8_t code[FK_SHA256_BYTES];
    uint8_t nonces[2u * FK_AUTH_NONCE_BYTES];
    if (!fk_auth_seed(auth)) {
        return -1;
    }
    for (uint32_t i = 0u; i < FK_AUTH_KEY_WORDS; ++i) {
        fk_put_u32(key_bytes + 4u * i, key[i]);
    }
    if (!is_fresh(auth, now_us)) {
        ++auth->nonces;
        fk_put_u32(nonces, auth->nonces);
        derive(auth->seed, of_nonce, nonces, 4u, code);
        copy(auth->nonce, code, FK_AUTH_NONCE_BYTES);
        derive(key_bytes, of_command, auth->nonce, FK_AUTH_NONCE_BYTES, auth->pending);
        auth->made_us = now_us;
        auth->has_pending = 1u;
    }
    copy(nonces, host_nonce, FK_AUTH_NONCE_BYTES);
    copy(nonces + FK_AUTH_NONCE_BYTES, auth->nonce, FK_AUTH_NONCE_BYTES);
    derive(key_bytes, of_robot, nonces, sizeof(nonces), code);
    copy(proof, code, FK_AUTH_PROOF_BYTES);
    return 0;
}

/* Compares in constant time, wherever the codes differ. */
static int32_t is_code_of(const uint8_t *key, const fk_frame_t *frame)
{
    const uint32_t length = frame->payload_length - FK_AUTH_CODE_BYTES;
    const uint8_t head[FK_FRAME_HEAD_BYTES] = {frame->type, frame->sequence};
    uint8_t code[FK_SHA256_BYTES];
    uint8_t differing = 0u;
    fk_hmac_t hmac;
    fk_hmac_begin(&hmac, key);
    fk_hmac_add(&hmac, head, sizeof(head));
    fk_hmac_add(&hmac, frame->payload, length);
    fk_hmac_end(&hmac, code);
    for (uint32_t i = 0u; i < FK_AUTH_CODE_BYTES; ++i) {
        differing |= code[i] ^ frame->payload[length + i];
    }
    return differing == 0u;
}

/* Whether a counter is new, and note that it is used from now on. Counters begin at 1. */
static int32_t take_counter(fk_auth_counters_t *counters, uint32_t counter)
{
    if (counter > counters->newest) {
        const uint32_t ahead = counter - counters->newest;
        counters->used = ((ahead < FK_AUTH_WINDOW) ? counters->used << ahead : 0u) | 1u;
        counters->newest = counter;
        return 1;
    }
    const uint32_t behind = counters->newest - counter;
    if (counter == 0u || behind >= FK_AUTH_WINDOW || (counters->used >> behind & 1u) != 0u) {
        return 0;
    }
    counters->used |= 1u << behind;
    return 1;
}

static void begin(fk_auth_t *auth)
{
    static const fk_auth_counters_t none = {0u, 0u};
    copy(auth->current, auth->pending, FK_AUTH_KEY_BYTES);
    auth->has_current = 1u;
    auth->has_pending = 0u;
    auth->fixes = none;
    auth->commands = none;
}

int8_t fk_auth_check(fk_auth_t *auth, fk_frame_t *frame, uint64_t now_us)
{
    if (frame->payload_length < FK_AUTH_TRAILER_BYTES) {
        return FK_STATUS_MAC;
    }
    const uint32_t length = frame->payload_length - FK_AUTH_TRAILER_BYTES;
    const uint8_t type = (uint8_t)(frame->type & ~FK_AUTH_BIT);
    if (auth->has_current == 0u || !is_code_of(auth->current, frame)) {
        if (!is_fresh(auth, now_us) || !is_code_of(auth->pending, frame)) {
            return FK_STATUS_MAC;
        }
        begin(auth);
    }
    if (!take_counter((type == FK_FRAME_FIX) ? &auth->fixes : &auth->commands, fk_get_u32(frame->payload + length))) {
        return FK_STATUS_MAC;
    }
    frame->type = type;
    frame->payload_length = length;
    return FK_STATUS_OK;
}
