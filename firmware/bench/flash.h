/* The flash region for tables, behind the image: fk_store.h says what lies in it. */
#ifndef FLASH_H
#define FLASH_H

#include "fk_store.h"

/* Where the linker script has put it. */
fk_flash_t fk_flash_region(void);

#endif
