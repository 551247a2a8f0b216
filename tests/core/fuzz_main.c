/* Tests only: a fuzzer guided by coverage, where the compiler brings no libFuzzer. Built with
 * -fsanitize-coverage=trace-pc (gcc) or trace-pc-guard (clang, zig); the same seed gives the same inputs.
 *
 * fuzz SEED INPUTS SEEDS_FILE: tries so many inputs, made from those that reached something new; then prints inputs,
 * inputs kept, and places of the code reached. The seeds' file: length u16, bytes, and so on.
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MAP 65536u
#define INPUT_BYTES 1024u
#define KEPT 8192u

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
void __sanitizer_cov_trace_pc(void);
void __sanitizer_cov_trace_pc_guard(uint32_t *guard);
void __sanitizer_cov_trace_pc_guard_init(uint32_t *begin, uint32_t *end);

typedef struct {
    uint32_t length;
    uint8_t bytes[INPUT_BYTES];
} input_t;

static uint8_t hits[MAP];
static uint8_t reached[MAP];
static input_t kept[KEPT];
static uint32_t kept_count;
static uint64_t random_state;

void __sanitizer_cov_trace_pc(void)
{
    uintptr_t place = (uintptr_t)__builtin_return_address(0);
    uint32_t index = (uint32_t)(place * 2654435761u >> 8) % MAP;
    hits[index] = (uint8_t)((hits[index] < 255u) ? hits[index] + 1u : 255u);
}

void __sanitizer_cov_trace_pc_guard(uint32_t *guard)
{
    uint32_t index = *guard % MAP;
    hits[index] = (uint8_t)((hits[index] < 255u) ? hits[index] + 1u : 255u);
}

void __sanitizer_cov_trace_pc_guard_init(uint32_t *begin, uint32_t *end)
{
    static uint32_t number;
    for (uint32_t *guard = begin; guard < end; ++guard) {
        if (*guard == 0u) {
            *guard = ++number;
        }
    }
}

static uint32_t below(uint32_t most)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)((random_state >> 32) * most >> 32);
}

/* 1, 2, 3, 4 to 7, 8 to 15, and so on: as often as that is as good as new. */
static uint8_t class_of(uint8_t count)
{
    static const uint8_t most[] = {1u, 2u, 3u, 7u, 15u, 31u, 127u, 255u};
    uint32_t i = 0u;
    while (count > most[i]) {
        ++i;
    }
    return (uint8_t)(1u << i);
}

static void attempt(const input_t *input)
{
    int is_new = 0;
    memset(hits, 0, sizeof(hits));
    uint8_t *exact = malloc(input->length + 1u);
    memcpy(exact, input->bytes, input->length);
    (void)LLVMFuzzerTestOneInput(exact, input->length);
    free(exact);
    for (uint32_t i = 0u; i < MAP; ++i) {
        if (hits[i] != 0u && (reached[i] & class_of(hits[i])) == 0u) {
            reached[i] |= class_of(hits[i]);
            is_new = 1;
        }
    }
    if (is_new != 0 && kept_count < KEPT) {
        kept[kept_count++] = *input;
    }
}

static void mutate(input_t *input)
{
    static const uint8_t telling[] = {0u, 1u, 2u, 3u, 4u, 5u, 8u, 18u, 19u, 100u, 127u, 128u, 226u, 254u, 255u};
    for (uint32_t k = 1u << below(5u); k > 0u; --k) {
        uint32_t at = (input->length > 0u) ? below(input->length) : 0u;
        uint32_t part = 1u + below(16u);
        switch (below(7u)) {
        case 0u:
            input->bytes[at] ^= (uint8_t)(1u << below(8u));
            break;
        case 1u:
            input->bytes[at] = (uint8_t)below(256u);
            break;
        case 2u:
            input->bytes[at] = telling[below(sizeof(telling))];
            break;
        case 3u: /* a part goes */
            part = (part > input->length - at) ? input->length - at : part;
            memmove(input->bytes + at, input->bytes + at + part, input->length - at - part);
            input->length -= part;
            break;
        case 4u: /* a part comes in */
            if (input->length + part <= INPUT_BYTES) {
                memmove(input->bytes + at + part, input->bytes + at, input->length - at);
                for (uint32_t i = 0u; i < part; ++i) {
                    input->bytes[at + i] = (uint8_t)below(256u);
                }
                input->length += part;
            }
            break;
        case 5u: { /* the end of another */
            const input_t *other = &kept[below(kept_count)];
            uint32_t from = (other->length > 0u) ? below(other->length) : 0u;
            uint32_t more = other->length - from;
            more = (more > INPUT_BYTES - at) ? INPUT_BYTES - at : more;
            memcpy(input->bytes + at, other->bytes + from, more);
            input->length = at + more;
            break;
        }
        default: /* four bytes as a number */
            if (at + 4u <= input->length) {
                uint32_t number = below(2u) != 0u ? 0x3f800000u : (uint32_t)1u << below(32u);
                memcpy(input->bytes + at, &number, 4u);
            }
            break;
        }
    }
}

int main(int argc, char **argv)
{
    input_t input = {0u, {0u}};
    uint8_t head[2];
    if (argc != 4 || LLVMFuzzerInitialize(&argc, &argv) != 0) {
        return 2;
    }
    random_state = strtoull(argv[1], NULL, 10) * 0x9E3779B97F4A7C15u + 1u;
    uint64_t inputs = strtoull(argv[2], NULL, 10);
    FILE *seeds = fopen(argv[3], "rb");
    if (seeds == NULL) {
        return 2;
    }
    attempt(&input);
    while (fread(head, 1u, 2u, seeds) == 2u) {
        input.length = head[0] | (uint32_t)head[1] << 8;
        if (input.length > INPUT_BYTES || fread(input.bytes, 1u, input.length, seeds) != input.length) {
            return 2;
        }
        attempt(&input);
    }
    (void)fclose(seeds);
    uint32_t of_seeds = kept_count;
    for (uint64_t n = 0u; n < inputs; ++n) {
        /* The newest more often than the others. */
        uint32_t which = (below(2u) != 0u) ? below(kept_count) : kept_count - 1u - below((kept_count + 3u) / 4u);
        input = kept[which];
        mutate(&input);
        attempt(&input);
    }
    uint32_t places = 0u;
    for (uint32_t i = 0u; i < MAP; ++i) {
        places += (reached[i] != 0u) ? 1u : 0u;
    }
    (void)printf("%llu %u %u %u\n", (unsigned long long)inputs, of_seeds, kept_count, places);
    return 0;
}
