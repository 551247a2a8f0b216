/* Tests only: a NOR flash that loses its power at any operation, and what uses a store on it without Python. */
#include "fk_auth.h"
#include "fk_frames_layout.h"
#include "fk_planner.h"
#include "fk_store.h"

enum { CUT_NOT_DONE, CUT_IN_PART, CUT_GARBAGE, CUT_MARGINAL };

typedef struct {
    uint8_t *bytes;       /* as they read since power-on */
    uint8_t *weak;        /* bits that a cut has left between 0 and 1, and that read otherwise at each power-on */
    uint32_t size;
    uint32_t operations;  /* words written and pages erased since power-on */
    uint32_t cut_at;      /* the operation that the power fails in, from 1 on; 0: none */
    uint32_t cut_how;
    uint32_t random;      /* state of the generator, not 0 */
    uint32_t dead;        /* the power has failed: nothing is done any more */
    uint32_t fail_at;     /* an operation that does nothing, though the power stays; 0: none */
    uint32_t fail_until;  /* and those behind it, up to this one */
    uint32_t refused;     /* what no flash can do: a bit back to 1, a word written twice, out of the region */
    uint32_t keep_from;   /* [keep_from, keep_to) holds the table in use */
    uint32_t keep_to;
    uint32_t touched;     /* operations in there */
    uint32_t words[2];    /* written: journal, slots */
    uint32_t erased[2];   /* likewise */
    uint32_t page_erases[64];
    uint32_t erase_places[64]; /* which operation erased the page last */
} fk_flash_sim_t;

/* What boots find with one wrong bit. */
typedef struct {
    uint32_t boots;
    uint32_t opened;    /* found no owner */
    uint32_t other;     /* found another key than before, or another table */
    uint32_t lost;      /* found the store's state lost */
    uint32_t unsettled; /* left something in doubt, or the next boot does not agree */
    uint32_t repaired;  /* wrote */
    uint32_t worst;     /* the first bit that changed anything; UINT32_MAX: none */
} fk_flips_t;

void fk_test_store_setup(fk_flash_sim_t *sim, fk_flash_t *flash);
void fk_test_store_power_on(fk_flash_sim_t *sim);
void fk_test_store_every_bit(fk_flash_sim_t *sim, fk_store_t *store, uint8_t *before, uint32_t from, uint32_t to,
                             uint32_t every, fk_flips_t *found);
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
    return (sim->operations >= sim->fail_at && sim->operations <= sim->fail_until) ? 0 : 1;
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
            sim->weak[offset + i] = 0u;
        } else if (sim->cut_how == CUT_MARGINAL) {
            sim->weak[offset + i] |= (uint8_t)(~*byte & noise);
            *byte |= (uint8_t)next_random(sim);
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
    if (todo == 2 && sim->cut_how == CUT_MARGINAL) {
        const uint32_t begun = old & ~word & next_random(sim);
        fk_put_u32(sim->weak + offset, fk_get_u32(sim->weak + offset) | (begun & noise));
        word = ~(begun & ~noise);
    } else if (todo == 2) {
        word = (sim->cut_how == CUT_IN_PART) ? (word | noise) : (word & noise);
    } else {
        fk_put_u32(sim->weak + offset, fk_get_u32(sim->weak + offset) & word); /* what is written to 0 is firm */
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

void fk_test_store_power_on(fk_flash_sim_t *sim)
{
    for (uint32_t i = 0u; i < sim->size; ++i) {
        if (sim->weak[i] != 0u) {
            sim->bytes[i] = (uint8_t)((sim->bytes[i] & ~sim->weak[i]) | (next_random(sim) & sim->weak[i]));
        }
    }
}

static int32_t is_same_state(const fk_store_t *one, const fk_store_t *other)
{
    uint32_t differing = (uint32_t)(one->image - other->image) | (uint32_t)(one->running ^ other->running) |
                         (uint32_t)(one->lost ^ other->lost);
    for (uint32_t i = 0u; i < FK_STORE_KEY_WORDS; ++i) {
        differing |= one->record.owner_key[i] ^ other->record.owner_key[i];
    }
    return differing == 0u;
}

/* Boot with each bit of [from, to) wrong by itself, and where that wrote, once more; of words that were never written one
 * bit in so many. The store has booted; before: room for what stands in flash. */
void fk_test_store_every_bit(fk_flash_sim_t *sim, fk_store_t *store, uint8_t *before, uint32_t from, uint32_t to,
                             uint32_t every, fk_flips_t *found)
{
    const fk_store_t sound = *store;
    static const fk_flips_t none;
    *found = none;
    found->worst = UINT32_MAX;
    for (uint32_t i = 0u; i < sim->size; ++i) {
        before[i] = sim->bytes[i];
    }
    for (uint32_t bit = 8u * from; bit < 8u * to; ++bit) {
        if (fk_get_u32(sim->bytes + bit / 32u * 4u) == UINT32_MAX && (bit + bit / 32u) % every != 0u) {
            continue;
        }
        sim->bytes[bit / 8u] ^= (uint8_t)(1u << (bit % 8u));
        sim->operations = 0u;
        (void)fk_store_boot(store, sound.flash, sound.built_in, sound.built_in_bytes);
        const fk_store_t first = *store;
        const uint32_t written = sim->operations;
        ++found->boots;
        found->opened += !fk_store_is_owned(&first) ? 1u : 0u;
        found->other += !is_same_state(&first, &sound) ? 1u : 0u;
        found->lost += first.lost;
        found->repaired += (written != 0u) ? 1u : 0u;
        if (found->worst == UINT32_MAX && !is_same_state(&first, &sound)) {
            found->worst = bit;
        }
        found->unsettled += first.in_doubt;
        if (written != 0u) {
            (void)fk_store_boot(store, sound.flash, sound.built_in, sound.built_in_bytes);
            found->unsettled += (!is_same_state(store, &first) || sim->operations != written || store->in_doubt != 0u);
            for (uint32_t i = 0u; i < FK_STORE_JOURNAL_PAGES * FK_FLASH_PAGE_BYTES; ++i) {
                sim->bytes[i] = before[i];
            }
        }
        sim->bytes[bit / 8u] = before[bit / 8u];
    }
    sim->operations = 0u;
    *store = sound;
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
