/* The part of the wear estimate that survives a reset, in RAM that the start-up code does not clear.
 *
 * Only the limbs' shares are kept, as STATUS reports them. After a reset nobody knows how long ago they were learned,
 * so each starts again as uncertain as fk_wear_restart() makes it, and without a current. They belong to one table,
 * and are dropped with it. After a loss of supply that RAM holds something else, which the CRC-32 shows.
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

/* Write the present shares, unless they are there already. A reset between any two words of it leaves the old
 * shares, the new ones or none. */
void fk_wear_keep(const fk_wear_t *wear, const fk_tables_t *tables, fk_wear_persistent_t *persistent);

/* After fk_wear_init() with these tables: continue from the persistent shares.
 * @retval 1  done
 * @retval 0  they are damaged, lost or of another table: nothing is changed
 */
int32_t fk_wear_resume(fk_wear_t *wear, fk_tables_t *tables, const fk_wear_persistent_t *persistent);

#endif
