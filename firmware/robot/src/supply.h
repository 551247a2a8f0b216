/* The supply, by the chip's power-fail comparator. */
#ifndef SUPPLY_H
#define SUPPLY_H

#include <stdint.h>

/* @param fell  called in an interrupt where the supply falls below 2.7 V */
void fk_supply_init(void (*fell)(void));

/* 1 where the supply is, or was since the last call, below that. Call it in every turn of the loop. */
int32_t fk_supply_is_low(uint64_t now_us);

#endif
