/* SHA-256 (FIPS 180-4), which identifies a table as a CRC-32 cannot, and HMAC-SHA-256 (RFC 2104), which authenticates
 * a frame's sender.
 */
#ifndef FK_SHA256_H
#define FK_SHA256_H

#include <stdint.h>

#define FK_SHA256_WORDS 8u
#define FK_SHA256_BYTES 32u
#define FK_SHA256_BLOCK_BYTES 64u

typedef struct {
    uint32_t state[FK_SHA256_WORDS];
    uint8_t block[FK_SHA256_BLOCK_BYTES]; /* bytes that do not fill a block yet */
    uint32_t length;                      /* bytes so far */
} fk_sha256_t;

typedef struct {
    fk_sha256_t inner;
    uint8_t outer[FK_SHA256_BLOCK_BYTES]; /* the key for the second pass */
} fk_hmac_t;

/* @param digest  eight words; the first one holds the digest's first four bytes, the first byte uppermost */
void fk_sha256(const uint8_t *bytes, uint32_t length, uint32_t digest[FK_SHA256_WORDS]);

/* A message authentication code of bytes that come in parts. */
void fk_hmac_begin(fk_hmac_t *hmac, const uint8_t key[FK_SHA256_BYTES]);
void fk_hmac_add(fk_hmac_t *hmac, const uint8_t *bytes, uint32_t length);

/* @param code  32 bytes, in the order in which RFC 4231 prints them */
void fk_hmac_end(fk_hmac_t *hmac, uint8_t code[FK_SHA256_BYTES]);

#endif
