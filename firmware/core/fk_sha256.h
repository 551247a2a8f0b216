/* SHA-256 (FIPS 180-4) of bytes that lie in memory: tells a table from any other, which a CRC-32 does not. */
#ifndef FK_SHA256_H
#define FK_SHA256_H

#include <stdint.h>

#define FK_SHA256_WORDS 8u

/* @param digest  eight words; the first one holds the digest's first four bytes, the first byte uppermost */
void fk_sha256(const uint8_t *bytes, uint32_t length, uint32_t digest[FK_SHA256_WORDS]);

#endif
