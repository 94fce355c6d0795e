// SPDX-License-Identifier: Apache-2.0
/// The same program on a workstation: input from stdin, result to stdout, no timer.
#include "board.h"

#include <stdio.h>
#include <stdlib.h>

size_t board_read(void* bytes, size_t n)
{
    return fread(bytes, 1, n, stdin);
}

void board_write(const char* text, size_t n)
{
    (void)fwrite(text, 1, n, stdout);
}

void board_raise_interrupt(void)
{
    board_interrupt();
}

uint32_t board_ticks(void)
{
    return 0;
}

void board_mark_stack(void)
{
}

size_t board_stack_used(void)
{
    return 0;
}

_Noreturn void board_exit(int status)
{
    exit(status);
}
