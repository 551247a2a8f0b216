/* Tests only: a NOR flash that loses its power at any operation, and what uses a store on it without Python. */
#include "fk_auth.h"
#include "fk_frames_layout.h"
#include "fk_planner.h"
#include "fk_store.h"

enum { CUT_NOT_DONE, CUT_IN_PART, CUT_GARBAGE };

typedef struct {
    uint8_t *bytes;
    uint32_t size;
    uint32_t operations;  /* words written and pages erased since power-on */
    uint32_t cut_at;      /* the operation that the power fails in, from 1 on; 0: none */
    uint32_t cut_how;
    uint32_t random;      /* state of the generator, not 0 */
    uint32_t dead;        /* the power has failed: nothing is done any more */
    uint32_t fail_at;     /* an operation that does nothing, though the power stays; 0: none */
    uint32_t refused;     /* what no flash can do: a bit back to 1, a word written twice, out of the region */
    uint32_t keep_from;   /* [keep_from, keep_to) holds the table in use */
    uint32_t keep_to;
    uint32_t touched;     /* operations in there */
    uint32_t words[2];    /* written: journal, slots */
    uint32_t erased[2];   /* likewise */
    uint32_t page_erases[64];
    uint32_t erase_places[64]; /* which operation erased the page last */
} fk_flash_sim_t;

void fk_test_store_setup(fk_flash_sim_t *sim, fk_flash_t *flash);
int8_t fk_test_store_upload(fk_store_t *store, const uint8_t *image, uint32_t length, uint32_t stop_at,
                            int8_t *error);
void fk_test_store_keep(fk_flash_sim_t *sim, const fk_store_t *store);
void fk_test_sha256(const uint8_t *bytes, uint32_t length, uint8_t *digest);

static uint32_t next_random(fk_flash_sim_t *sim) /* Marsaglia 2003, xorshift */
{
    sim->random ^= sim->random << 13;
    sim->random ^= sim->random >> 17;
    sim->random ^= sim->random << 5;
    return sim->random;
}

static uint32_t is_slot(uint32_t offset)
{
    return (offset >= FK_STORE_JOURNAL_PAGES * FK_FLASH_PAGE_BYTES) ? 1u : 0u;
}

/* Count an operation. 0: it is not done; 1: do it; 2: the power fails in it. */
static int32_t begin_operation(fk_flash_sim_t *sim, uint32_t offset, uint32_t bytes)
{
    if (sim->dead != 0u) {
        return 0;
    }
    ++sim->operations;
    if (offset + bytes > sim->size || offset % bytes != 0u) {
        ++sim->refused;
        return 0;
    }
    sim->touched += (offset < sim->keep_to && offset + bytes > sim->keep_from) ? 1u : 0u;
    if (sim->operations == sim->cut_at) {
        sim->dead = 1u;
        return 2;
    }
    return (sim->operations == sim->fail_at) ? 0 : 1;
}

void fk_flash_erase(const fk_flash_t *flash, uint32_t offset)
{
    fk_flash_sim_t *sim = flash->context;
    int32_t todo = begin_operation(sim, offset, FK_FLASH_PAGE_BYTES);
    uint32_t part = next_random(sim) % FK_FLASH_PAGE_BYTES;
    if (todo == 0 || (todo == 2 && sim->cut_how == CUT_NOT_DONE)) {
        return;
    }
    ++sim->erased[is_slot(offset)];
    ++sim->page_erases[offset / FK_FLASH_PAGE_BYTES];
    sim->erase_places[offset / FK_FLASH_PAGE_BYTES] = sim->operations;
    for (uint32_t i = 0u; i < FK_FLASH_PAGE_BYTES; ++i) {
        uint8_t *byte = &sim->bytes[offset + i];
        uint8_t noise = (uint8_t)next_random(sim);
        if (todo == 1 || (sim->cut_how == CUT_IN_PART && i < part)) {
            *byte = 0xffu;
        } else if (sim->cut_how == CUT_IN_PART) {
            *byte = (i == part) ? (uint8_t)(*byte | noise) : *byte;
        } else {
            *byte = noise;
        }
    }
}

static void program_word(fk_flash_sim_t *sim, uint32_t offset, uint32_t word)
{
    int32_t todo = begin_operation(sim, offset, 4u);
    uint32_t noise = next_random(sim);
    if (todo == 0 || (todo == 2 && sim->cut_how == CUT_NOT_DONE)) {
        return;
    }
    uint32_t old = fk_get_u32(sim->bytes + offset);
    sim->refused += (old != UINT32_MAX) ? 1u : 0u; /* each word once; so no bit goes back to 1 either */
    ++sim->words[is_slot(offset)];
    if (todo == 2) {
        word = (sim->cut_how == CUT_IN_PART) ? (word | noise) : (word & noise);
    }
    fk_put_u32(sim->bytes + offset, old & word);
}

void fk_flash_program(const fk_flash_t *flash, uint32_t offset, const uint32_t *words, uint32_t count)
{
    for (uint32_t i = 0u; i < count; ++i) {
        program_word(flash->context, offset + 4u * i, words[i]);
    }
}

void fk_test_store_setup(fk_flash_sim_t *sim, fk_flash_t *flash)
{
    flash->base = sim->bytes;
    flash->context = sim;
}

/* Everything that operates from now on within the table in use is counted. */
void fk_test_store_keep(fk_flash_sim_t *sim, const fk_store_t *store)
{
    sim->keep_from = 0u;
    sim->keep_to = 0u;
    if (store->running != FK_STORE_BUILT_IN) {
        sim->keep_from = (uint32_t)(store->image - sim->bytes);
        sim->keep_to = sim->keep_from + store->image_bytes;
    }
}

/* A whole update, or chunks up to stop_at and no COMMIT. */
int8_t fk_test_store_upload(fk_store_t *store, const uint8_t *image, uint32_t length, uint32_t stop_at,
                            int8_t *error)
{
    uint32_t hash[FK_SHA256_WORDS];
    fk_sha256(image, length, hash);
    int8_t status = fk_store_begin(store, length, hash);
    while (status == FK_STATUS_OK && store->next_offset < length && store->next_offset < stop_at) {
        uint32_t at = store->next_offset;
        uint32_t count = (length - at < FK_STORE_CHUNK_BYTES) ? length - at : FK_STORE_CHUNK_BYTES;
        status = fk_store_chunk(store, at, image + at, count);
    }
    return (status == FK_STATUS_OK && stop_at >= length) ? fk_store_commit(store, error) : status;
}

void fk_test_sha256(const uint8_t *bytes, uint32_t length, uint8_t *digest)
{
    uint32_t words[FK_SHA256_WORDS];
    fk_sha256(bytes, length, words);
    for (uint32_t i = 0u; i < 32u; ++i) {
        digest[i] = (uint8_t)(words[i / 4u] >> (24u - 8u * (i % 4u)));
    }
}

/* The port's randomness: counts up, so that a test knows it. With fk_test_random_fails it has none. */
uint8_t fk_test_random_fails;
static uint8_t random_next;

int32_t fk_port_random(uint8_t *bytes, uint32_t count)
{
    for (uint32_t i = 0u; i < count; ++i) {
        bytes[i] = random_next++;
    }
    return (fk_test_random_fails != 0u) ? -1 : 0;
}
