/* What the board gives the test program: a UART to write to. */
#ifndef FK_QEMU_STARTUP_H
#define FK_QEMU_STARTUP_H

#include <stdint.h>

#define FK_EXIT_FAULT 9u /* the program's exit code after a fault; main returns others */

void fk_put_text(const char *text);

/* Eight hexadecimal digits, then `after`. */
void fk_put_word(uint32_t word, char after);

#endif
