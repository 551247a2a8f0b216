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
    return FK_OK;
}
