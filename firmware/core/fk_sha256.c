#include "fk_sha256.h"

#define LENGTH_AT 56u

/* FIPS 180-4, 4.2.2: the cube roots of the first 64 primes. */
static const uint32_t constants[64] = {
    0x428a2f98u, 0x71374491u, 0xb5c0fbcfu, 0xe9b5dba5u, 0x3956c25bu, 0x59f111f1u, 0x923f82a4u, 0xab1c5ed5u,
    0xd807aa98u, 0x12835b01u, 0x243185beu, 0x550c7dc3u, 0x72be5d74u, 0x80deb1feu, 0x9bdc06a7u, 0xc19bf174u,
    0xe49b69c1u, 0xefbe4786u, 0x0fc19dc6u, 0x240ca1ccu, 0x2de92c6fu, 0x4a7484aau, 0x5cb0a9dcu, 0x76f988dau,
    0x983e5152u, 0xa831c66du, 0xb00327c8u, 0xbf597fc7u, 0xc6e00bf3u, 0xd5a79147u, 0x06ca6351u, 0x14292967u,
    0x27b70a85u, 0x2e1b2138u, 0x4d2c6dfcu, 0x53380d13u, 0x650a7354u, 0x766a0abbu, 0x81c2c92eu, 0x92722c85u,
    0xa2bfe8a1u, 0xa81a664bu, 0xc24b8b70u, 0xc76c51a3u, 0xd192e819u, 0xd6990624u, 0xf40e3585u, 0x106aa070u,
    0x19a4c116u, 0x1e376c08u, 0x2748774cu, 0x34b0bcb5u, 0x391c0cb3u, 0x4ed8aa4au, 0x5b9cca4fu, 0x682e6ff3u,
    0x748f82eeu, 0x78a5636fu, 0x84c87814u, 0x8cc70208u, 0x90befffau, 0xa4506cebu, 0xbef9a3f7u, 0xc67178f2u,
};

static uint32_t rotated(uint32_t word, uint32_t bits) { return (word >> bits) | (word << (32u - bits)); }

/* FIPS 180-4, 6.2.2; the message schedule is kept as a ring of 16 words. */
static void add_block(uint32_t state[FK_SHA256_WORDS], const uint8_t *block)
{
    uint32_t words[16];
    uint32_t v[FK_SHA256_WORDS];
    for (uint32_t i = 0u; i < 16u; ++i) {
        words[i] = ((uint32_t)block[4u * i] << 24) | ((uint32_t)block[4u * i + 1u] << 16) |
                   ((uint32_t)block[4u * i + 2u] << 8) | (uint32_t)block[4u * i + 3u];
    }
    for (uint32_t i = 0u; i < FK_SHA256_WORDS; ++i) {
        v[i] = state[i];
    }
    for (uint32_t round = 0u; round < 64u; ++round) {
        uint32_t word = words[round % 16u];
        if (round >= 16u) {
            uint32_t late = words[(round + 14u) % 16u];
            uint32_t early = words[(round + 1u) % 16u];
            word += words[(round + 9u) % 16u] + (rotated(late, 17u) ^ rotated(late, 19u) ^ (late >> 10)) +
                    (rotated(early, 7u) ^ rotated(early, 18u) ^ (early >> 3));
            words[round % 16u] = word;
        }
        uint32_t first = v[7] + (rotated(v[4], 6u) ^ rotated(v[4], 11u) ^ rotated(v[4], 25u)) +
                         ((v[4] & v[5]) ^ (~v[4] & v[6])) + constants[round] + word;
        uint32_t second = (rotated(v[0], 2u) ^ rotated(v[0], 13u) ^ rotated(v[0], 22u)) +
                          ((v[0] & v[1]) ^ (v[0] & v[2]) ^ (v[1] & v[2]));
        for (uint32_t i = 7u; i > 0u; --i) {
            v[i] = v[i - 1u];
        }
        v[4] += first;
        v[0] = first + second;
    }
    for (uint32_t i = 0u; i < FK_SHA256_WORDS; ++i) {
        state[i] += v[i];
    }
}

static void begin(fk_sha256_t *hash)
{
    static const uint32_t start[FK_SHA256_WORDS] = {0x6a09e667u, 0xbb67ae85u, 0x3c6ef372u, 0xa54ff53au,
                                                    0x510e527fu, 0x9b05688cu, 0x1f83d9abu, 0x5be0cd19u};
    for (uint32_t i = 0u; i < FK_SHA256_WORDS; ++i) {
        hash->state[i] = start[i];
    }
    hash->length = 0u;
}

/* Whole blocks are taken from where they lie. */
static void add(fk_sha256_t *hash, const uint8_t *bytes, uint32_t length)
{
    uint32_t filled = hash->length % FK_SHA256_BLOCK_BYTES;
    uint32_t at = 0u;
    hash->length += length;
    while (at < length) {
        if (filled == 0u && length - at >= FK_SHA256_BLOCK_BYTES) {
            add_block(hash->state, bytes + at);
            at += FK_SHA256_BLOCK_BYTES;
            continue;
        }
        hash->block[filled] = bytes[at];
        ++filled;
        ++at;
        if (filled == FK_SHA256_BLOCK_BYTES) {
            add_block(hash->state, hash->block);
            filled = 0u;
        }
    }
}

static void end(fk_sha256_t *hash)
{
    uint32_t filled = hash->length % FK_SHA256_BLOCK_BYTES;
    hash->block[filled] = 0x80u;
    for (uint32_t i = filled + 1u; i < FK_SHA256_BLOCK_BYTES; ++i) {
        hash->block[i] = 0u;
    }
    if (filled >= LENGTH_AT) {
        add_block(hash->state, hash->block);
        for (uint32_t i = 0u; i < LENGTH_AT; ++i) {
            hash->block[i] = 0u;
        }
    }
    /* The length in bits, 64 of them, the uppermost first; there are never more than 2^32 bytes. */
    uint64_t bits = (uint64_t)hash->length * 8u;
    for (uint32_t i = 0u; i < 8u; ++i) {
        hash->block[FK_SHA256_BLOCK_BYTES - 1u - i] = (uint8_t)((bits >> (8u * i)) & 0xffu);
    }
    add_block(hash->state, hash->block);
}

void fk_sha256(const uint8_t *bytes, uint32_t length, uint32_t digest[FK_SHA256_WORDS])
{
    fk_sha256_t hash;
    begin(&hash);
    add(&hash, bytes, length);
    end(&hash);
    for (uint32_t i = 0u; i < FK_SHA256_WORDS; ++i) {
        digest[i] = hash.state[i];
    }
}

static void put_words(const uint32_t words[FK_SHA256_WORDS], uint8_t *bytes)
{
    for (uint32_t i = 0u; i < FK_SHA256_BYTES; ++i) {
        bytes[i] = (uint8_t)((words[i / 4u] >> (8u * (3u - i % 4u))) & 0xffu);
    }
}

void fk_hmac_begin(fk_hmac_t *hmac, const uint8_t key[FK_SHA256_BYTES])
{
    uint8_t padded[FK_SHA256_BLOCK_BYTES];
    for (uint32_t i = 0u; i < FK_SHA256_BLOCK_BYTES; ++i) {
        uint8_t byte = (i < FK_SHA256_BYTES) ? key[i] : 0u;
        padded[i] = byte ^ 0x36u;
        hmac->outer[i] = byte ^ 0x5cu;
    }
    begin(&hmac->inner);
    add(&hmac->inner, padded, sizeof(padded));
}

void fk_hmac_add(fk_hmac_t *hmac, const uint8_t *bytes, uint32_t length) { add(&hmac->inner, bytes, length); }

void fk_hmac_end(fk_hmac_t *hmac, uint8_t code[FK_SHA256_BYTES])
{
    end(&hmac->inner);
    put_words(hmac->inner.state, code);
    begin(&hmac->inner);
    add(&hmac->inner, hmac->outer, FK_SHA256_BLOCK_BYTES);
    add(&hmac->inner, code, FK_SHA256_BYTES);
    end(&hmac->inner);
    put_words(hmac->inner.state, code);
}
