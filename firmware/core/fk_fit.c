#include "fk_fit.h"

#include "fk_robot_config.h"

/* 64 bits: a table may hold a delay near 2^32 us. */
uint64_t fk_fit_stroke_us(const fk_tables_t *tables)
{
    uint64_t pulse_us = tables->pulse_us;
    uint64_t delay_us = tables->second_delay_us;
    uint64_t second_us = (delay_us > pulse_us) ? delay_us : pulse_us;
    return second_us + FK_STROKE_GAP_US + pulse_us + FK_STROKE_GAP_US;
}

/* Pairs of rows that a look-up reads where it visits every leaf (nearest.c). Widest product: 2^13 * 65535 < 2^32. */
static uint32_t pairs_of_rows(const fk_tables_t *tables)
{
    uint32_t pairs = 0u;
    uint32_t begin = 0u;
    for (uint32_t leaf = 1u; leaf <= 1u << tables->tree_levels; ++leaf) {
        const uint32_t end = (leaf * tables->states) >> tables->tree_levels;
        pairs += (end - (begin & ~1u) + 1u) / 2u;
        begin = end;
    }
    return pairs;
}

/* Widest: 2^13 leaves and 65535 states in 2^15 + 2^13 pairs are 77 ms, 33 times that 2.6e9 ns, and 923000 us are 9.23e8 ns. */
uint32_t fk_fit_transitions(const fk_tables_t *tables)
{
    const uint32_t look_up_ns =
        FK_NODE_MOST_NS + (FK_LEAF_MOST_NS << tables->tree_levels) + FK_PAIR_MOST_NS * pairs_of_rows(tables);
    const uint32_t periods = 1u + FK_LOOK_UPS_WITHIN_US / tables->period_us;
    const uint32_t look_ups = FK_LOOK_UPS_BESIDE + ((periods < FK_LOOK_UPS_WITHIN_MAX) ? periods : FK_LOOK_UPS_WITHIN_MAX);
    const uint32_t taken_us = FK_SEARCH_FIXED_US + look_up_ns * look_ups / 1000u;
    const uint32_t left_us = (taken_us < FK_SEARCH_MOST_US) ? FK_SEARCH_MOST_US - taken_us : 0u;
    return left_us * 1000u / (FK_TRANSITION_MOST_NS + look_up_ns / tables->actions);
}

int32_t fk_fit_open(const uint8_t *image, uint32_t image_bytes, fk_tables_t *tables)
{
    int32_t error = fk_tables_open(image, image_bytes, tables);
    if (error == FK_OK) {
        error = fk_tables_check_robot(tables, FK_ROBOT_ID);
    }
    if (error != FK_OK) {
        return error;
    }
    if (tables->pulse_us > FK_PULSE_MAX_US || fk_fit_stroke_us(tables) > tables->period_us) {
        return FK_ERROR_IMAGE_TIMES;
    }
    return (fk_fit_transitions(tables) < tables->actions) ? FK_ERROR_IMAGE_COUNT : FK_OK;
}
