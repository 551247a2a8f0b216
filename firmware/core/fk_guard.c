#include "fk_guard.h"

#include "fk_frames_layout.h"

#define CHECK_START 0x64726147u /* not 0, so that memory full of zeros has a wrong checksum */

/* One step of the checksum. It is a bijection of each argument while the other is fixed, so a change of one word
 * always changes the result. */
static uint32_t mixed(uint32_t check, uint32_t word) { return (((check << 19) | (check >> 13)) ^ word) * 0x9E3779B1u; }

static uint32_t mixed_time(uint32_t check, uint64_t time_us)
{
    return mixed(mixed(check, (uint32_t)time_us), (uint32_t)(time_us >> 32));
}

/* It begins with the limb's number, so that the history of one limb does not pass for that of another. */
static uint32_t check_of_limb(const fk_guard_t *guard, uint32_t at)
{
    const fk_guard_limb_t *limb = &guard->limbs[at];
    uint32_t check = CHECK_START + at;
    for (uint32_t i = 0u; i < FK_GUARD_HISTORY; ++i) {
        check = mixed(mixed_time(check, limb->start_us[i]), limb->on_us[i]);
    }
    return mixed(mixed_time(check, limb->off_us), ((uint32_t)limb->was_cut << 16) | limb->next);
}

static uint32_t check_of_loop(const fk_guard_t *guard)
{
    return mixed(mixed_time(CHECK_START, guard->fix_us), guard->closed_loop);
}

static int32_t limb_is_sound(const fk_guard_t *guard, uint32_t limb)
{
    return guard->limbs[limb].check == check_of_limb(guard, limb);
}

static int32_t loop_is_sound(const fk_guard_t *guard) { return guard->check == check_of_loop(guard); }

static void seal_limb(fk_guard_t *guard, uint32_t limb) { guard->limbs[limb].check = check_of_limb(guard, limb); }

static void seal_loop(fk_guard_t *guard) { guard->check = check_of_loop(guard); }

int32_t fk_guard_is_sound(const fk_guard_t *guard)
{
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        if (!limb_is_sound(guard, limb)) {
            return 0;
        }
    }
    return loop_is_sound(guard);
}

void fk_guard_seal(fk_guard_t *guard)
{
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        seal_limb(guard, limb);
    }
    seal_loop(guard);
}

/* So long is each pulse of a history that is filled, the last one shorter: as long as a pulse can be, or longer where
 * firmware with longer pulses has kept the heat, so that all of FK_DUTY_ON_MAX_US has room. */
#define FILL_EVEN_US (FK_DUTY_ON_MAX_US / (FK_GUARD_HISTORY - 1u) + 1u)
#define FILL_US (FILL_EVEN_US > FK_PULSE_MAX_US ? FILL_EVEN_US : FK_PULSE_MAX_US)

/* The history of a limb that was on for on_us in all just before time 0, which is entered as pulses that all begin at
 * time 0: each leaves the duty window later than the heat that it stands for. One entry stays unused, as no more than
 * the others can overlap one window. More than FK_DUTY_ON_MAX_US counts as that, which allows no pulse. */
static void fill_limb(fk_guard_t *guard, uint32_t at, uint32_t on_us)
{
    fk_guard_limb_t *limb = &guard->limbs[at];
    limb->next = 0u;
    on_us = (on_us > FK_DUTY_ON_MAX_US) ? FK_DUTY_ON_MAX_US : on_us;
    for (uint32_t i = 0u; i < FK_GUARD_HISTORY; ++i) {
        const uint32_t part_us = (on_us > FILL_US) ? FILL_US : on_us;
        limb->start_us[i] = 0u;
        limb->on_us[i] = part_us;
        limb->next = (uint16_t)(limb->next + ((part_us > 0u) ? 1u : 0u));
        on_us -= part_us;
    }
    limb->off_us = 0u; /* it may have been on until the reset */
    limb->was_cut = 0u;
    seal_limb(guard, at);
}

void fk_guard_init(fk_guard_t *guard)
{
    for (uint32_t at = 0u; at < FK_LIMBS_MAX; ++at) {
        /* One entry, longer than any pulse: as much of it leaves the duty window as a new pulse brings into it, so that
         * until it began before that window there is no room for even the shortest. */
        fk_guard_limb_t *limb = &guard->limbs[at];
        fill_limb(guard, at, 0u);
        limb->on_us[0] = FK_DUTY_ON_MAX_US;
        limb->next = 1u;
        limb->off_us = FK_PORT_LATE_US;
        seal_limb(guard, at);
    }
    guard->fix_us = 0u;
    guard->closed_loop = 0u;
    seal_loop(guard);
}

/* Here and below a damaged part is not written to, because a new checksum would make it pass for sound. */
void fk_guard_closed_loop(fk_guard_t *guard, int32_t closed)
{
    if (loop_is_sound(guard)) {
        guard->closed_loop = (closed != 0) ? 1u : 0u;
        seal_loop(guard);
    }
}

void fk_guard_note_fix(fk_guard_t *guard, uint64_t capture_us)
{
    if (loop_is_sound(guard) && capture_us > guard->fix_us) {
        guard->fix_us = capture_us;
        seal_loop(guard);
    }
}

uint64_t fk_guard_lost_us(const fk_guard_t *guard)
{
    return (guard->fix_us == 0u) ? 0u : guard->fix_us + FK_FIX_LOST_US + 1u;
}

/* Where the duty window begins that ends at until_us. Of all windows the fullest end with a pulse, and fk_guard_allow()
 * tests the one that ends with each new pulse. On the pins an old pulse may be late and the new one on time, so the
 * window here reaches back FK_PORT_LATE_US further. */
static uint64_t window_from_us(uint64_t until_us)
{
    const uint64_t window_us = FK_DUTY_WINDOW_US + FK_PORT_LATE_US;
    return (until_us > window_us) ? until_us - window_us : 0u;
}

/* How long the limb is on within that window. */
static uint64_t on_time_us(const fk_guard_limb_t *limb, uint64_t until_us)
{
    const uint64_t from_us = window_from_us(until_us);
    uint64_t sum_us = 0u;
    for (uint32_t i = 0u; i < FK_GUARD_HISTORY; ++i) {
        uint64_t end_us = limb->start_us[i] + limb->on_us[i];
        uint64_t start_us = (limb->start_us[i] > from_us) ? limb->start_us[i] : from_us;
        if (end_us > start_us) {
            sum_us += end_us - start_us;
        }
    }
    return sum_us;
}

/* Whether the entry that a new pulse would overwrite lies in the window that ends with it. Pulses that rest between each
 * other have left it by then; entries that stand for heat from before a reset, side by side, may not have. */
static int32_t is_full(const fk_guard_limb_t *limb, uint64_t until_us)
{
    return limb->start_us[limb->next] + limb->on_us[limb->next] > window_from_us(until_us);
}

uint32_t fk_guard_remembered(const fk_guard_limb_t *limb, uint64_t now_us)
{
    const uint64_t from_us = window_from_us(now_us);
    uint32_t count = FK_GUARD_HISTORY;
    for (uint32_t at = limb->next; count > 0u; --count, ++at) {
        const uint32_t entry = at % FK_GUARD_HISTORY;
        if (limb->start_us[entry] + limb->on_us[entry] > from_us) {
            break;
        }
    }
    return count;
}

static uint32_t last_entry(const fk_guard_limb_t *limb)
{
    return (limb->next + FK_GUARD_HISTORY - 1u) % FK_GUARD_HISTORY;
}

static uint32_t crc_of(const fk_guard_persistent_t *persistent)
{
    uint32_t crc = 0u;
    for (uint32_t i = 0u; i < FK_LIMBS_MAX; ++i) {
        uint8_t bytes[4];
        fk_put_u32(bytes, persistent->on_us[i]);
        crc = fk_crc32(crc, bytes, sizeof(bytes));
    }
    return crc ^ CHECK_START;
}

void fk_guard_keep(const fk_guard_t *guard, fk_guard_persistent_t *persistent)
{
    for (uint32_t i = 0u; i < FK_LIMBS_MAX; ++i) {
        const fk_guard_limb_t *limb = &guard->limbs[i];
        uint32_t last = last_entry(limb);
        persistent->on_us[i] = (uint32_t)on_time_us(limb, limb->start_us[last] + limb->on_us[last]);
    }
    persistent->crc = crc_of(persistent);
}

void fk_guard_invalidate(fk_guard_persistent_t *persistent) { persistent->crc = ~crc_of(persistent); }

int32_t fk_guard_resume(fk_guard_t *guard, const fk_guard_persistent_t *persistent)
{
    if (persistent->crc != crc_of(persistent)) {
        return 0;
    }
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        fill_limb(guard, limb, persistent->on_us[limb]);
    }
    return 1;
}

int32_t fk_guard_allow(fk_guard_t *guard, uint8_t limb_mask, uint32_t pulse_us, uint64_t now_us)
{
    if (!fk_guard_is_sound(guard)) {
        return -1;
    }
    if (limb_mask == 0u || pulse_us == 0u || pulse_us > FK_PULSE_MAX_US) {
        return 0;
    }
    if (guard->closed_loop != 0u && (guard->fix_us == 0u || now_us + FK_PORT_LATE_US > guard->fix_us + FK_FIX_FRESH_US)) {
        return 0;
    }
    uint64_t end_us = now_us + pulse_us;
    uint32_t limbs_on = 0u;
    for (uint32_t i = 0u; i < FK_LIMBS_MAX; ++i) {
        const fk_guard_limb_t *limb = &guard->limbs[i];
        if ((limb_mask & (1u << i)) == 0u) {
            limbs_on += (limb->off_us > now_us && limb->was_cut == 0u) ? 1u : 0u;
            continue;
        }
        ++limbs_on;
        if (now_us < limb->off_us + FK_REST_MIN_US) {
            return 0;
        }
        if (is_full(limb, end_us) || on_time_us(limb, end_us) + pulse_us > FK_DUTY_ON_MAX_US) {
            return 0;
        }
    }
    if (limbs_on > FK_LIMBS_AT_ONCE_MAX) {
        return 0;
    }
    for (uint32_t i = 0u; i < FK_LIMBS_MAX; ++i) {
        if ((limb_mask & (1u << i)) != 0u) {
            fk_guard_limb_t *limb = &guard->limbs[i];
            limb->start_us[limb->next] = now_us;
            limb->on_us[limb->next] = pulse_us;
            limb->next = (uint16_t)((limb->next + 1u) % FK_GUARD_HISTORY);
            limb->off_us = end_us + FK_PORT_LATE_US;
            limb->was_cut = 0u;
            seal_limb(guard, i);
        }
    }
    return 1;
}

void fk_guard_not_begun(fk_guard_t *guard, uint8_t limb_mask)
{
    for (uint32_t i = 0u; i < FK_LIMBS_MAX; ++i) {
        if ((limb_mask & (1u << i)) != 0u && limb_is_sound(guard, i)) {
            fk_guard_limb_t *limb = &guard->limbs[i];
            uint32_t last = last_entry(limb);
            limb->on_us[last] = 0u;
            limb->off_us = limb->start_us[last];
            seal_limb(guard, i);
        }
    }
}

void fk_guard_cut(fk_guard_t *guard, uint64_t now_us)
{
    uint64_t off_us = now_us + FK_PORT_LATE_US;
    for (uint32_t i = 0u; i < FK_LIMBS_MAX; ++i) {
        fk_guard_limb_t *limb = &guard->limbs[i];
        if (limb->off_us > off_us && limb_is_sound(guard, i)) {
            uint32_t last = last_entry(limb);
            uint64_t on_us = off_us - limb->start_us[last];
            /* It may have begun on time and been cut late: on from its start to off_us, but no longer than it was
             * to last. */
            limb->on_us[last] = (limb->on_us[last] > on_us) ? (uint32_t)on_us : limb->on_us[last];
            limb->off_us = off_us;
            limb->was_cut = 1u;
            seal_limb(guard, i);
        }
    }
}
