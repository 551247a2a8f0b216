/* Who may command this robot. If it has an owner's key, the commands that move or change it need a message
 * authentication code (HMAC-SHA-256, RFC 2104, truncated to 8 bytes) under a key of this conversation, which only a
 * host with the owner's key can derive. DISARM and STOP never need one.
 *
 *   host  -> CHALLENGE  its nonce
 *   robot -> answer     its own nonce, and its proof: HMAC(key, "frogkick robot" host's nonce, robot's nonce)
 *   host  -> command    of a type with FK_AUTH_BIT set; behind its payload a counter and a code:
 *                       HMAC(HMAC(key, "frogkick command" robot's nonce), type sequence payload counter)
 *
 * A code of one direction or conversation is not valid in another, so nothing can be reflected or replayed. Counters
 * that were used are known in a window of 32, because frames may overtake each other (anti-replay window: RFC 4303,
 * 3.4.3). FIX has counters and a window of its own: a camera sends so many that a command which is lost and comes again
 * would fall out of the window.
 *
 * The robot's nonce names the next conversation. It stays the same until that conversation begins, until all are ended,
 * or until it is FK_AUTH_FRESH_US old. So nothing is kept of a CHALLENGE, and a stranger's does not displace the owner's.
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
#define FK_AUTH_FRESH_US 5000000u /* from the making of a nonce to the first command of its conversation, at most */

typedef struct {
    uint32_t newest; /* largest counter so far */
    uint32_t used;   /* bit i: counter newest - i was used */
} fk_auth_counters_t;

typedef struct {
    uint8_t seed[FK_SHA256_BYTES];      /* from the port: what nonces are made of */
    uint8_t nonce[FK_AUTH_NONCE_BYTES]; /* of the next conversation */
    uint8_t pending[FK_AUTH_KEY_BYTES]; /* key of the next conversation */
    uint8_t current[FK_AUTH_KEY_BYTES]; /* key of the conversation whose commands are accepted */
    uint64_t made_us;                   /* when the nonce was made */
    uint32_t nonces;                    /* so far */
    fk_auth_counters_t fixes;           /* of the current conversation */
    fk_auth_counters_t commands;        /* of all others but FIX */
    uint8_t is_seeded;
    uint8_t has_pending;
    uint8_t has_current;
} fk_auth_t;

/* Implemented by the port: bytes that nobody can predict.
 * @retval 0         done, within some milliseconds
 * @retval negative  the port has none, so this robot can have no owner
 */
int32_t fk_port_random(uint8_t *bytes, uint32_t count);

/* No conversation is authenticated yet. */
void fk_auth_init(fk_auth_t *auth);

/* Whether a frame's type says that a counter and a code follow the payload. */
static inline int32_t fk_auth_has_code(uint8_t type)
{
    return (type & (FK_ANSWER_BIT | FK_EVENT_BIT | FK_AUTH_BIT)) == FK_AUTH_BIT;
}

/* 1 where the port has random bytes, else 0; it is asked until it gives them once. */
int32_t fk_auth_seed(fk_auth_t *auth);

/* End all conversations, also the next one: what was sent before is worth nothing, whenever it arrives. */
void fk_auth_end(fk_auth_t *auth);

/* Prove to a host that this robot has the key, and offer the next conversation. The current one stays valid until a command
 * of the next one has arrived.
 * @param key  words in little-endian order
 * @retval 0   done; auth->nonce is the robot's
 * @retval -1  the port has no randomness
 */
int32_t fk_auth_answer(fk_auth_t *auth, const uint32_t key[FK_AUTH_KEY_WORDS],
                       const uint8_t host_nonce[FK_AUTH_NONCE_BYTES], uint64_t now_us,
                       uint8_t proof[FK_AUTH_PROOF_BYTES]);

/* Check a frame with FK_AUTH_BIT, and remove that bit, the counter and the code from it.
 * @retval FK_STATUS_OK
 * @retval FK_STATUS_MAC  its code is wrong, or its counter was used before; the frame is not changed
 */
int8_t fk_auth_check(fk_auth_t *auth, fk_frame_t *frame, uint64_t now_us);

#endif
