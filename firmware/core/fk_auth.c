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
    auth->challenges = 0u;
    auth->newest = 0u;
    auth->used = 0u;
    auth->is_seeded = 0u;
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

/* HMAC(key, label nonces) */
static void derive(const uint8_t *key, const uint8_t *label, const uint8_t *host_nonce, const uint8_t *robot_nonce,
                   uint8_t code[FK_SHA256_BYTES])
{
    fk_hmac_t hmac;
    fk_hmac_begin(&hmac, key);
    fk_hmac_add(&hmac, label, LABEL_BYTES);
    fk_hmac_add(&hmac, host_nonce, FK_AUTH_NONCE_BYTES);
    fk_hmac_add(&hmac, robot_nonce, FK_AUTH_NONCE_BYTES);
    fk_hmac_end(&hmac, code);
}

int32_t fk_auth_answer(fk_auth_t *auth, const uint32_t key[FK_AUTH_KEY_WORDS],
                       const uint8_t host_nonce[FK_AUTH_NONCE_BYTES], uint8_t robot_nonce[FK_AUTH_NONCE_BYTES],
                       uint8_t proof[FK_AUTH_PROOF_BYTES])
{
    uint8_t key_bytes[FK_AUTH_KEY_BYTES];
    uint8_t code[FK_SHA256_BYTES];
    uint8_t count[FK_AUTH_NONCE_BYTES] = {0u};
    if (!fk_auth_seed(auth)) {
        return -1;
    }
    ++auth->challenges;
    fk_put_u32(count, auth->challenges);
    derive(auth->seed, of_nonce, host_nonce, count, code);
    copy(robot_nonce, code, FK_AUTH_NONCE_BYTES);
    for (uint32_t i = 0u; i < FK_AUTH_KEY_WORDS; ++i) {
        fk_put_u32(key_bytes + 4u * i, key[i]);
    }
    derive(key_bytes, of_robot, host_nonce, robot_nonce, code);
    copy(proof, code, FK_AUTH_PROOF_BYTES);
    derive(key_bytes, of_command, host_nonce, robot_nonce, auth->pending);
    auth->has_pending = 1u;
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
static int32_t take_counter(fk_auth_t *auth, uint32_t counter)
{
    if (counter > auth->newest) {
        const uint32_t ahead = counter - auth->newest;
        auth->used = ((ahead < FK_AUTH_WINDOW) ? auth->used << ahead : 0u) | 1u;
        auth->newest = counter;
        return 1;
    }
    const uint32_t behind = auth->newest - counter;
    if (counter == 0u || behind >= FK_AUTH_WINDOW || (auth->used >> behind & 1u) != 0u) {
        return 0;
    }
    auth->used |= 1u << behind;
    return 1;
}

int8_t fk_auth_check(fk_auth_t *auth, fk_frame_t *frame)
{
    if (frame->payload_length < FK_AUTH_TRAILER_BYTES) {
        return FK_STATUS_MAC;
    }
    const uint32_t length = frame->payload_length - FK_AUTH_TRAILER_BYTES;
    if (auth->has_current == 0u || !is_code_of(auth->current, frame)) {
        if (auth->has_pending == 0u || !is_code_of(auth->pending, frame)) {
            return FK_STATUS_MAC;
        }
        copy(auth->current, auth->pending, FK_AUTH_KEY_BYTES);
        auth->has_current = 1u;
        auth->has_pending = 0u;
        auth->newest = 0u;
        auth->used = 0u;
    }
    if (!take_counter(auth, fk_get_u32(frame->payload + length))) {
        return FK_STATUS_MAC;
    }
    frame->type &= (uint8_t)~FK_AUTH_BIT;
    frame->payload_length = length;
    return FK_STATUS_OK;
}
