/* The flash partition for tables: fk_store.h says what lies in it. */
#ifndef FLASH_H
#define FLASH_H

#include "fk_store.h"

fk_flash_t fk_flash_region(void);

#endif
