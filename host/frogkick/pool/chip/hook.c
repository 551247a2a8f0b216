/* Called by unicorn before each instruction and at each data access: counts cycles, and stops the core where the
 * model has to look. Compiled at first use by hook.py, which holds the same structure.
 */
#include <stdint.h>

enum { STOP_NONE, STOP_LIMIT, STOP_WFE, STOP_WFI, STOP_FPU, STOP_UNKNOWN, STOP_UNALIGNED };
enum {
    FLAG_KNOWN = 1,    /* the entry has been decoded */
    FLAG_WFE = 2,
    FLAG_WFI = 4,
    FLAG_FPU = 8,
    FLAG_IN_IT = 16,   /* inside an IT block: the core is not stopped here, its state would be lost */
    FLAG_ALIGNED = 32, /* its data accesses fault unless they are word-aligned */
    FLAGS_LOOK = FLAG_WFE | FLAG_WFI | FLAG_FPU
};

typedef struct {
    uint64_t time;         /* 1/256 cycles */
    uint64_t limit;        /* 1/256 cycles: stop before the first instruction at or after this */
    uint64_t instructions;
    uint32_t address;      /* of the latest instruction */
    uint32_t expected;     /* address that follows it in memory */
    uint32_t entry;        /* its table entry: cycles * 256 + flags */
    uint32_t stop;         /* why the core was stopped */
    uint32_t fpu_enabled;
    uint32_t fetch_wait;   /* 1/256 cycles added to each instruction */
    uint32_t data_wait;    /* 1/256 cycles added to each read of data from flash */
    uint32_t refill;       /* 1/256 cycles added where an instruction does not follow the last in memory */
    uint32_t flash_bytes;
    uint32_t unaligned;    /* address of the access that stopped the core */
    uint32_t late;         /* instructions that the emulator ran in spite of a stop; an error */
    const uint16_t *table; /* an entry for each halfword of flash */
    int (*emu_stop)(void *);
    int (*reg_read)(void *, int, void *);
    int (*reg_write)(void *, int, const void *);
    int32_t cpsr;          /* unicorn's number of that register */
} fk_hook_state_t;

static void stop(fk_hook_state_t *state, void *uc, uint32_t why, uint32_t address)
{
    state->stop = why;
    state->address = address;
    state->emu_stop(uc);
}

/* unicorn 2.1 copies the IT state of an instruction into the core before a memory hook, and never clears it: after a
 * conditional POP {pc} the code returned to would be taken for the inside of an IT block, where branches are illegal
 * and stops are ignored. Code inside the block does not look at the copy, so it can be cleared at once. */
static void clear_it_state(fk_hook_state_t *state, void *uc)
{
    const uint32_t it_bits = (0x3Fu << 10) | (0x3u << 25);
    uint32_t cpsr = 0u;
    (void)state->reg_read(uc, state->cpsr, &cpsr);
    if ((cpsr & it_bits) != 0u) {
        cpsr &= ~it_bits;
        (void)state->reg_write(uc, state->cpsr, &cpsr);
    }
}

/* Instructions between two places that were skipped by their condition in an IT block: the emulator does not call
 * for those. 0 where there is anything else between, which means a branch. A block has at most 4 of 4 bytes. */
static uint32_t skipped_in_it(const fk_hook_state_t *state, uint32_t from, uint32_t to)
{
    uint32_t count = 0u;
    if (to < from || to - from > 16u || (state->table[from >> 1] & FLAG_IN_IT) == 0u) {
        return 0u;
    }
    for (uint32_t address = from; address < to; address += 2u) {
        uint32_t entry = state->table[address >> 1];
        if ((entry & FLAG_KNOWN) != 0u) {
            if ((entry & FLAG_IN_IT) == 0u) {
                return 0u;
            }
            ++count;
        }
    }
    return count;
}

void fk_hook_code(void *uc, uint64_t address64, uint32_t size, void *user);
void fk_hook_memory(void *uc, int type, uint64_t address64, int size, int64_t value, void *user);

void fk_hook_code(void *uc, uint64_t address64, uint32_t size, void *user)
{
    fk_hook_state_t *state = user;
    uint32_t address = (uint32_t)address64;
    uint32_t entry = state->table[address >> 1];

    if (state->stop != STOP_NONE) {
        ++state->late; /* the emulator went on after a stop: what it runs now is not counted */
        state->emu_stop(uc);
        return;
    }
    if ((entry & FLAG_KNOWN) == 0u) {
        stop(state, uc, STOP_UNKNOWN, address);
        return;
    }
    if (state->time >= state->limit && (entry & FLAG_IN_IT) == 0u) {
        stop(state, uc, STOP_LIMIT, address);
        return;
    }
    if ((entry & FLAGS_LOOK) != 0u) {
        if ((entry & FLAG_FPU) != 0u) {
            if (state->fpu_enabled == 0u) {
                stop(state, uc, STOP_FPU, address);
                return;
            }
        } else {
            stop(state, uc, ((entry & FLAG_WFE) != 0u) ? STOP_WFE : STOP_WFI, address);
            return;
        }
    }
    if (address != state->expected) {
        uint32_t skipped = skipped_in_it(state, state->expected, address);
        state->instructions += skipped;
        state->time += (skipped > 0u) ? (uint64_t)skipped * (256u + state->fetch_wait) : state->refill;
    }
    state->address = address;
    state->expected = address + size;
    state->entry = entry;
    state->time += (entry & 0xFF00u) + state->fetch_wait;
    ++state->instructions;
}

void fk_hook_memory(void *uc, int type, uint64_t address64, int size, int64_t value, void *user)
{
    fk_hook_state_t *state = user;
    uint32_t address = (uint32_t)address64;
    (void)type;
    (void)size;
    (void)value;
    if (address < state->flash_bytes) {
        state->time += state->data_wait;
    }
    if ((state->entry & FLAG_IN_IT) != 0u) {
        clear_it_state(state, uc);
    }
    if ((address & 3u) != 0u && (state->entry & FLAG_ALIGNED) != 0u && state->stop == STOP_NONE) {
        state->unaligned = address;
        stop(state, uc, STOP_UNALIGNED, state->address);
    }
}
