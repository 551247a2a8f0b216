/* Called by unicorn before each instruction and at each data access: counts cycles, and stops the core where the
 * model has to look. Compiled at first use by emulator.py, which holds the same structure.
 */
#include <stdint.h>

enum { STOP_NONE, STOP_LIMIT, STOP_WFE, STOP_WFI, STOP_FPU, STOP_UNKNOWN, STOP_UNALIGNED, STOP_RETURN };
enum {
    FLAG_KNOWN = 1,    /* the entry has been decoded */
    FLAG_WFE = 2,
    FLAG_WFI = 4,
    FLAG_FPU = 8,
    FLAG_IN_IT = 16,   /* inside an IT block: the core is not stopped here, its state would be lost */
    FLAG_ALIGNED = 32, /* its data accesses fault unless they are word-aligned */
    FLAG_RETURN = 64,  /* no instruction: where a call from outside returns to */
    FLAGS_LOOK = FLAG_WFE | FLAG_WFI | FLAG_FPU | FLAG_RETURN
};

/* The instruction cache: lines of 16 bytes, the width of the flash, two ways, the older one goes. */
enum { LINE_SHIFT = 4, CACHE_SETS = 64, CACHE_WAYS = 2 };

typedef struct {
    uint64_t time;         /* 1/256 cycles */
    uint64_t limit;        /* 1/256 cycles: stop before the first instruction at or after this */
    uint64_t instructions;
    uint32_t address;      /* of the latest instruction */
    uint32_t expected;     /* address that follows it in memory */
    uint32_t entry;        /* its table entry: flags, cycles << 8, cycles behind the one before it << 16 */
    uint32_t stop;         /* why the core was stopped */
    uint32_t fpu_enabled;
    uint32_t fetch_wait;   /* 1/256 cycles added to each instruction */
    uint32_t miss_wait;    /* 1/256 cycles added for each line of flash that the instruction cache does not hold */
    uint32_t line;         /* the line that the latest instruction ended in */
    uint32_t misses;
    uint32_t data_wait;    /* 1/256 cycles added to each read of data from flash */
    uint32_t refill;       /* 1/256 cycles added where an instruction does not follow the last in memory */
    uint32_t flash_bytes;
    uint32_t unaligned;    /* address of the access that stopped the core */
    uint32_t late;         /* instructions that the emulator ran in spite of a stop; an error */
    const uint32_t *table; /* an entry for each halfword of flash */
    uint32_t *cache;       /* CACHE_SETS x CACHE_WAYS lines + 1, the latest used first; null = off */
    uint64_t *profile;     /* 1/256 cycles spent at each halfword of flash; null = not wanted */
    uint32_t *visits;      /* how often each halfword was run; wanted with profile */
    uint64_t counted;      /* time up to which the profile is */
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

static void fetch_line(fk_hook_state_t *state, uint32_t line)
{
    uint32_t *ways = &state->cache[(line % CACHE_SETS) * CACHE_WAYS];

    if (ways[0] != line + 1u) {
        if (ways[1] != line + 1u) {
            state->time += state->miss_wait;
            ++state->misses;
        }
        ways[1] = ways[0];
        ways[0] = line + 1u;
    }
    state->line = line;
}

void fk_hook_code(void *uc, uint64_t address64, uint32_t size, void *user);
void fk_hook_memory(void *uc, int type, uint64_t address64, int size, int64_t value, void *user);
void fk_hook_block(void *uc, uint64_t address, uint32_t size, void *user);

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
        } else if ((entry & FLAG_RETURN) != 0u) {
            stop(state, uc, STOP_RETURN, address);
            return;
        } else {
            stop(state, uc, ((entry & FLAG_WFE) != 0u) ? STOP_WFE : STOP_WFI, address);
            return;
        }
    }
    uint32_t cycles = (entry >> 16) << 8; /* in 1/256 */
    if (address != state->expected) {
        uint32_t skipped = skipped_in_it(state, state->expected, address);
        cycles = entry & 0xFF00u;
        state->instructions += skipped;
        state->time += (skipped > 0u) ? (uint64_t)skipped * (256u + state->fetch_wait) : state->refill;
    }
    if (state->profile != 0) {
        /* What the instruction before took, with its waits and its refill. */
        state->profile[state->address >> 1] += state->time - state->counted;
        state->counted = state->time;
        ++state->visits[address >> 1];
    }
    if (state->cache != 0) {
        if (address >> LINE_SHIFT != state->line) {
            fetch_line(state, address >> LINE_SHIFT);
        }
        if ((address + size - 1u) >> LINE_SHIFT != state->line) {
            fetch_line(state, (address + size - 1u) >> LINE_SHIFT);
        }
    }
    state->address = address;
    state->expected = address + size;
    state->entry = entry;
    state->time += cycles + state->fetch_wait;
    ++state->instructions;
}

void fk_hook_memory(void *uc, int type, uint64_t address64, int size, int64_t value, void *user)
{
    fk_hook_state_t *state = user;
    uint32_t address = (uint32_t)address64;
    /* An unaligned word or halfword is taken in two or three parts, a cycle and a wait each. */
    uint32_t parts = (size == 4 && (address & 1u) != 0u) ? 3u : ((address & ((uint32_t)size - 1u)) != 0u) ? 2u : 1u;
    (void)type;
    (void)value;
    state->time += (parts - 1u) * 256u;
    if (address < state->flash_bytes) {
        state->time += parts * state->data_wait;
    }
    if ((state->entry & FLAG_IN_IT) != 0u) {
        clear_it_state(state, uc);
    }
    if ((address & 3u) != 0u && (state->entry & FLAG_ALIGNED) != 0u && state->stop == STOP_NONE) {
        state->unaligned = address;
        stop(state, uc, STOP_UNALIGNED, state->address);
    }
}

/* Alone, where cycles do not matter: before each block of instructions without a branch, to stop what does not end.
 * An instruction has at most 4 bytes, so a block has at least as many as are counted here. */
void fk_hook_block(void *uc, uint64_t address, uint32_t size, void *user)
{
    fk_hook_state_t *state = user;

    if (state->instructions >= state->limit) {
        stop(state, uc, STOP_LIMIT, (uint32_t)address);
    }
    state->instructions += (size + 3u) / 4u;
}
