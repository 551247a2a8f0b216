#include "fk_guard.h"

void fk_guard_init(fk_guard_t *guard)
{
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        for (uint32_t i = 0u; i < FK_GUARD_HISTORY; ++i) {
            guard->limbs[limb].start_us[i] = 0u;
            guard->limbs[limb].end_us[i] = 0u;
        }
        guard->limbs[limb].next = 0u;
    }
}

static uint64_t last_end_us(const fk_guard_limb_t *limb)
{
    return limb->end_us[(limb->next + FK_GUARD_HISTORY - 1u) % FK_GUARD_HISTORY];
}

/* Time on within the window that ends at until_us. Any window of that length that holds more would have to end
 * inside a pulse, and pulses are judged at their own end, when the window is fullest. */
static uint64_t on_time_us(const fk_guard_limb_t *limb, uint64_t until_us)
{
    uint64_t from_us = (until_us > FK_DUTY_WINDOW_US) ? until_us - FK_DUTY_WINDOW_US : 0u;
    uint64_t sum_us = 0u;
    for (uint32_t i = 0u; i < FK_GUARD_HISTORY; ++i) {
        uint64_t start_us = (limb->start_us[i] > from_us) ? limb->start_us[i] : from_us;
        if (limb->end_us[i] > start_us) {
            sum_us += limb->end_us[i] - start_us;
        }
    }
    return sum_us;
}

int32_t fk_guard_allow(fk_guard_t *guard, uint8_t limb_mask, uint32_t pulse_us, uint64_t now_us)
{
    if (limb_mask == 0u || pulse_us == 0u || pulse_us > FK_PULSE_MAX_US) {
        return 0;
    }
    uint64_t end_us = now_us + pulse_us;
    uint32_t limbs_on = 0u;
    for (uint32_t i = 0u; i < FK_LIMBS_MAX; ++i) {
        const fk_guard_limb_t *limb = &guard->limbs[i];
        uint64_t rested_from_us = last_end_us(limb);
        if ((limb_mask & (1u << i)) == 0u) {
            limbs_on += (rested_from_us > now_us) ? 1u : 0u;
            continue;
        }
        ++limbs_on;
        if (now_us < rested_from_us + FK_REST_MIN_US) {
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
        }
    }
    return 1;
}

void fk_guard_cut(fk_guard_t *guard, uint64_t now_us)
{
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        for (uint32_t i = 0u; i < FK_GUARD_HISTORY; ++i) {
            if (guard->limbs[limb].end_us[i] > now_us) {
                guard->limbs[limb].end_us[i] = now_us;
            }
        }
    }
}
