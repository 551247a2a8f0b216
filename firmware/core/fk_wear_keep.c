#include "fk_wear_keep.h"

#include "fk_frames_layout.h"

/* volatile, so that the compiler keeps the order of the stores. */
static void put(volatile uint32_t *word, uint32_t value) { *word = value; }

static uint32_t crc_of(const fk_wear_persistent_t *persistent, uint32_t learn)
{
    uint8_t bytes[4];
    fk_put_u32(bytes, learn);
    uint32_t crc = fk_crc32(0u, bytes, sizeof(bytes));
    fk_put_u32(bytes, persistent->table_crc32);
    crc = fk_crc32(crc, bytes, sizeof(bytes));
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        fk_put_u32(bytes, persistent->lost[limb]);
        crc = fk_crc32(crc, bytes, sizeof(bytes));
    }
    return crc;
}

static int32_t is_kept(const fk_wear_t *wear, const fk_tables_t *tables, const fk_wear_persistent_t *persistent)
{
    uint32_t differs = (persistent->learn ^ wear->learn) | (persistent->table_crc32 ^ tables->image_crc32);
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        differs |= persistent->lost[limb] ^ wear->lost[limb];
    }
    return differs == 0u;
}

void fk_wear_keep(const fk_wear_t *wear, const fk_tables_t *tables, fk_wear_persistent_t *persistent)
{
    if (is_kept(wear, tables, persistent)) {
        return;
    }
    put(&persistent->learn, FK_LEARN_OFF); /* nothing is kept until all other words are written */
    put(&persistent->table_crc32, tables->image_crc32);
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        put(&persistent->lost[limb], wear->lost[limb]);
    }
    put(&persistent->crc, crc_of(persistent, wear->learn));
    put(&persistent->learn, wear->learn);
}

int32_t fk_wear_resume(fk_wear_t *wear, fk_tables_t *tables, const fk_wear_persistent_t *persistent)
{
    if ((persistent->learn != FK_LEARN_ON && persistent->learn != FK_LEARN_HELD) ||
        persistent->crc != crc_of(persistent, persistent->learn) || tables->wear_knots == 0u ||
        persistent->table_crc32 != tables->image_crc32) {
        return 0;
    }
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        if (persistent->lost[limb] > ((limb < tables->limbs) ? FK_LOST_MAX : 0u)) {
            return 0;
        }
    }
    for (uint32_t limb = 0u; limb < FK_LIMBS_MAX; ++limb) {
        wear->lost[limb] = (uint16_t)persistent->lost[limb];
    }
    wear->learn = (uint8_t)persistent->learn;
    fk_wear_restart(wear);
    fk_wear_use(wear, tables);
    return 1;
}
