#include "fk_guard.h"

#include "fk_frames_layout.h"

#define KEPT_MARK 0x64726147u /* so that RAM of zeros keeps nothing */

void fk_guard_init(fk_guard_t *guard)
{
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        for (uint32_t i = 0u; i < FK_GUARD_HISTORY; ++i) {
            guard->limbs[limb].start_us[i] = 0u;
            guard->limbs[limb].end_us[i] = 0u;
        }
        guard->limbs[limb].next = 0u;
        guard->limbs[limb].off_us = 0u; /* a limb may have been on until boot */
        guard->limbs[limb].was_cut = 0u;
    }
    guard->fix_us = 0u;
    guard->closed_loop = 0u;
}

void fk_guard_closed_loop(fk_guard_t *guard, int32_t closed) { guard->closed_loop = (closed != 0) ? 1u : 0u; }

void fk_guard_note_fix(fk_guard_t *guard, uint64_t capture_us)
{
    if (capture_us > guard->fix_us) {
        guard->fix_us = capture_us;
    }
}

uint64_t fk_guard_lost_us(const fk_guard_t *guard)
{
    return (guard->fix_us == 0u) ? 0u : guard->fix_us + FK_FIX_LOST_US + 1u;
}

int32_t fk_guard_is_sound(const fk_guard_t *guard, uint64_t now_us)
{
    if (guard->closed_loop > 1u || guard->fix_us > now_us) {
        return 0;
    }
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        if (guard->limbs[limb].next >= FK_GUARD_HISTORY) {
            return 0;
        }
        for (uint32_t i = 0u; i < FK_GUARD_HISTORY; ++i) {
            uint64_t start_us = guard->limbs[limb].start_us[i];
            uint64_t end_us = guard->limbs[limb].end_us[i];
            if (start_us > now_us || end_us < start_us || end_us - start_us > FK_PULSE_MAX_US) {
                return 0;
            }
        }
    }
    return 1;
}

/* Time on within the window that ends at until_us. Any window of that length that holds more would have to end
 * inside a pulse, and pulses are judged at their own end, when the window is fullest. On the pins the old pulses may be
 * late and the new one in time: the window reaches back that much further. */
static uint64_t on_time_us(const fk_guard_limb_t *limb, uint64_t until_us)
{
    uint64_t window_us = FK_DUTY_WINDOW_US + FK_PORT_LATE_US;
    uint64_t from_us = (until_us > window_us) ? until_us - window_us : 0u;
    uint64_t sum_us = 0u;
    for (uint32_t i = 0u; i < FK_GUARD_HISTORY; ++i) {
        uint64_t start_us = (limb->start_us[i] > from_us) ? limb->start_us[i] : from_us;
        if (limb->end_us[i] > start_us) {
            sum_us += limb->end_us[i] - start_us;
        }
    }
    return sum_us;
}

static uint32_t crc_of(const fk_guard_kept_t *kept)
{
    uint32_t crc = 0u;
    for (uint32_t i = 0u; i < FK_LIMBS_MAX; ++i) {
        uint8_t bytes[4];
        fk_put_u32(bytes, kept->on_us[i]);
        crc = fk_crc32(crc, bytes, sizeof(bytes));
    }
    return crc ^ KEPT_MARK;
}

void fk_guard_keep(const fk_guard_t *guard, fk_guard_kept_t *kept)
{
    for (uint32_t i = 0u; i < FK_LIMBS_MAX; ++i) {
        const fk_guard_limb_t *limb = &guard->limbs[i];
        uint32_t last = (limb->next + FK_GUARD_HISTORY - 1u) % FK_GUARD_HISTORY;
        kept->on_us[i] = (uint32_t)on_time_us(limb, limb->end_us[last]);
    }
    kept->crc = crc_of(kept);
}

void fk_guard_resume(fk_guard_t *guard, const fk_guard_kept_t *kept)
{
    if (kept->crc != crc_of(kept)) {
        return;
    }
    for (uint32_t i = 0u; i < FK_LIMBS_MAX; ++i) {
        fk_guard_limb_t *limb = &guard->limbs[i];
        uint32_t left_us = kept->on_us[i];
        /* Pulses side by side from time 0 on: as many as fitted into a window fit into the books. */
        while (left_us > 0u && limb->next + 1u < FK_GUARD_HISTORY) {
            uint32_t part_us = (left_us > FK_PULSE_MAX_US) ? FK_PULSE_MAX_US : left_us;
            limb->end_us[limb->next] = part_us;
            ++limb->next;
            left_us -= part_us;
        }
    }
}

int32_t fk_guard_allow(fk_guard_t *guard, uint8_t limb_mask, uint32_t pulse_us, uint64_t now_us)
{
    if (limb_mask == 0u || pulse_us == 0u || pulse_us > FK_PULSE_MAX_US) {
        return 0;
    }
    if (guard->closed_loop != 0u && now_us + FK_PORT_LATE_US > guard->fix_us + FK_FIX_FRESH_US) {
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
        if (on_time_us(limb, end_us) + pulse_us > FK_DUTY_ON_MAX_US) {
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
            limb->end_us[limb->next] = end_us;
            limb->next = (limb->next + 1u) % FK_GUARD_HISTORY;
            limb->off_us = end_us + FK_PORT_LATE_US;
            limb->was_cut = 0u;
        }
    }
    return 1;
}

void fk_guard_not_begun(fk_guard_t *guard, uint8_t limb_mask)
{
    for (uint32_t i = 0u; i < FK_LIMBS_MAX; ++i) {
        if ((limb_mask & (1u << i)) != 0u) {
            fk_guard_limb_t *limb = &guard->limbs[i];
            uint32_t last = (limb->next + FK_GUARD_HISTORY - 1u) % FK_GUARD_HISTORY;
            limb->end_us[last] = limb->start_us[last];
            limb->off_us = limb->start_us[last];
        }
    }
}

void fk_guard_cut(fk_guard_t *guard, uint64_t now_us)
{
    uint64_t off_us = now_us + FK_PORT_LATE_US;
    for (uint32_t i = 0u; i < FK_LIMBS_MAX; ++i) {
        fk_guard_limb_t *limb = &guard->limbs[i];
        if (limb->off_us > off_us) {
            uint32_t last = (limb->next + FK_GUARD_HISTORY - 1u) % FK_GUARD_HISTORY;
            /* Begun in time and cut late, it was on for that much longer. */
            limb->end_us[last] = (limb->end_us[last] > off_us) ? off_us : limb->end_us[last];
            limb->off_us = off_us;
            limb->was_cut = 1u;
        }
    }
}
