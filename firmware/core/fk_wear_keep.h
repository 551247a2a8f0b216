/* What a reset must not wipe out of what was learned of the limbs, in RAM that the start-up leaves alone.
 *
 * Kept are the shares alone, as STATUS tells them. After a reset nobody knows how long ago they were learned, so that each
 * starts again as uncertain as fk_wear_restart() makes it, and without a current. They belong to one table, and are
 * forgotten with it. After a time without supply that RAM holds something else, which the CRC-32 tells.
 */
#ifndef FK_WEAR_KEEP_H
#define FK_WEAR_KEEP_H

#include <stdint.h>

#include "fk_wear.h"

typedef struct {
    uint32_t learn;              /* FK_LEARN_ON or FK_LEARN_HELD; any other number: nothing is kept */
    uint32_t table_crc32;        /* of the table whose limbs these are */
    uint32_t lost[FK_LIMBS_MAX]; /* 0 to FK_LOST_MAX; 0 of limbs that the table does not have */
    uint32_t crc;                /* over all above */
} fk_wear_persistent_t;

/* Keep what is known now, where something else is kept. A reset at any word of it leaves what was kept before, or nothing, or
 * what is kept now. */
void fk_wear_keep(const fk_wear_t *wear, const fk_tables_t *tables, fk_wear_persistent_t *persistent);

/* After fk_wear_init with these tables: go on from what was kept.
 * @retval 1  done
 * @retval 0  what was kept is damaged, lost or of another table: nothing is changed
 */
int32_t fk_wear_resume(fk_wear_t *wear, fk_tables_t *tables, const fk_wear_persistent_t *persistent);

#endif
