/* The test program's output where there is an operating system: the same lines, on standard output. */
#include <stdio.h>

#include "startup.h"

void fk_put_text(const char *text)
{
    (void)fputs(text, stdout);
}

void fk_put_word(uint32_t word, char after)
{
    (void)printf("%08x%c", (unsigned)word, after);
}
