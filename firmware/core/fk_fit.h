/* Whether a table is for this robot and within the guard's limits. */
#ifndef FK_FIT_H
#define FK_FIT_H

#include <stdint.h>

#include "fk_planner.h"

#define FK_STROKE_GAP_US 1000u /* from a pulse's end until the port's one pulse timer is free for the next */

/* Open an image, every byte of it checked, and check that it is for this robot and within the guard's limits.
 * @retval 0         tables filled
 * @retval negative  fk_error_t of fk_tables_open, FK_ERROR_ROBOT where the image is for another robot,
 *                   FK_ERROR_IMAGE_TIMES where its pulse is above the guard's limit, or a whole stroke longer than
 *                   the period
 */
int32_t fk_fit_open(const uint8_t *image, uint32_t image_bytes, fk_tables_t *tables);

/* From the first pulse's start until the pulse timer is free after the second. */
uint64_t fk_fit_stroke_us(const fk_tables_t *tables);

#endif
