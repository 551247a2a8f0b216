/* Who may command this robot. Where it has an owner's key, the commands that move it or change it need an authentication
 * code (HMAC-SHA-256, RFC 2104, cut to 8 bytes) of a conversation whose host has proved that it has the key too. What
 * switches off never needs one.
 *
 *   host  -> CHALLENGE  its nonce
 *   robot -> answer     its own nonce, and its proof: HMAC(key, "frogkick robot" nonces)
 *   host  -> command    of a type with FK_AUTH_BIT set; behind its payload a counter and a code:
 *                       HMAC(HMAC(key, "frogkick command" nonces), type sequence payload counter)
 *
 * No code of one direction or conversation is one of another, so nothing can be sent back or sent again. Counters that
 * were had are known in a window of 32, as frames overtake each other (RFC 4303, 3.4.3).
 */
#ifndef FK_AUTH_H
#define FK_AUTH_H

#include <stdint.h>

#include "fk_frames.h"
#include "fk_sha256.h"

#define FK_AUTH_KEY_BYTES FK_SHA256_BYTES
#define FK_AUTH_KEY_WORDS 8u
#define FK_AUTH_NONCE_BYTES 16u
#define FK_AUTH_PROOF_BYTES 16u
#define FK_AUTH_COUNTER_BYTES 4u
#define FK_AUTH_CODE_BYTES 8u
#define FK_AUTH_TRAILER_BYTES (FK_AUTH_COUNTER_BYTES + FK_AUTH_CODE_BYTES)
#define FK_AUTH_WINDOW 32u

typedef struct {
    uint8_t seed[FK_SHA256_BYTES];     /* from the port: what nonces are made of */
    uint8_t pending[FK_AUTH_KEY_BYTES]; /* key of the conversation that the last CHALLENGE began */
    uint8_t current[FK_AUTH_KEY_BYTES]; /* key of the one whose commands are believed */
    uint32_t challenges;
    uint32_t newest; /* counter */
    uint32_t had;    /* bit i: newest - i was had */
    uint8_t is_seeded;
    uint8_t has_pending;
    uint8_t has_current;
} fk_auth_t;

/* Implemented by the port: bytes that nobody can predict.
 * @retval 0         done, within some milliseconds
 * @retval negative  it has none: then this robot can have no owner
 */
int32_t fk_port_random(uint8_t *bytes, uint32_t count);

/* No conversation is authenticated. */
void fk_auth_init(fk_auth_t *auth);

/* A type that says that a code follows its payload. */
static inline int32_t fk_auth_has_code(uint8_t type)
{
    return (type & (FK_ANSWER_BIT | FK_EVENT_BIT | FK_AUTH_BIT)) == FK_AUTH_BIT;
}

/* Whether the port has randomness; asks it once. */
int32_t fk_auth_seed(fk_auth_t *auth);

/* Prove to a host that this robot has the key, and begin a conversation; the one before is believed until a command of
 * the new one has come.
 * @param key  words in little-endian order
 * @retval 0   done
 * @retval -1  the port has no randomness
 */
int32_t fk_auth_answer(fk_auth_t *auth, const uint32_t key[FK_AUTH_KEY_WORDS],
                       const uint8_t host_nonce[FK_AUTH_NONCE_BYTES], uint8_t robot_nonce[FK_AUTH_NONCE_BYTES],
                       uint8_t proof[FK_AUTH_PROOF_BYTES]);

/* Check a frame with FK_AUTH_BIT, and make of it the command without.
 * @retval FK_STATUS_OK
 * @retval FK_STATUS_MAC  its code is wrong, or it was had before; the frame is as it was
 */
int8_t fk_auth_check(fk_auth_t *auth, fk_frame_t *frame);

#endif
