/* The supply, by the chip's power-fail comparator. */
#ifndef SUPPLY_H
#define SUPPLY_H

#include <stdint.h>

void fk_supply_init(void);

/* 1 where the chip's supply is, or was since the last call, below FK_BOARD_SUPPLY_LEAST. Call it in every turn of the
 * loop; a supply that falls wakes the processor. */
int32_t fk_supply_is_low(void);

#endif
