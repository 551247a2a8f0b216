/* The emitted planner alone on the chip: what a host calls to time it. Never part of an emitted directory. */
#include "clock.h"
#include "fk_planner.h"
#include "fk_table.h"

int main(void);

int main(void)
{
    fk_clock_init(); /* also the instruction cache */
    /* Their addresses are wanted, so that the linker keeps them. */
    __asm__ volatile("" : : "r"(fk_plan), "r"(fk_tables_open), "r"(fk_tables_action), "r"(fk_tables_check_robot),
                     "r"(&fk_table_image), "r"(&fk_table_image_bytes));
    for (;;) {
        __asm__ volatile("wfe");
    }
}
