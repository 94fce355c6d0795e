// SPDX-License-Identifier: Apache-2.0
/// What main.c needs of a board. mps2_an500.c: the emulated Cortex-M7; workstation.c: the same program on this machine.
#ifndef IPE_BOARD_H
#define IPE_BOARD_H

#include <stddef.h>
#include <stdint.h>

enum { IPE_BOARD_INSTRUCTIONS_PER_TICK = 40 };  ///< 1 ns each (icount shift=0), the timer at 25 MHz

/// Bytes of the recorded input, in order; fewer at its end.
size_t board_read(void* bytes, size_t n);
/// Text to the result.
void board_write(const char* text, size_t n);
/// Raise the controller's interrupt: on the chip board_interrupt() runs before this returns.
void board_raise_interrupt(void);
/// Implemented by main.c.
void board_interrupt(void);
/// A free-running timer.
uint32_t board_ticks(void);
/// From here on board_stack_used() counts.
void board_mark_stack(void);
/// Bytes of stack used at most since then; 0 where it is not known.
size_t board_stack_used(void);
/// End the program.
_Noreturn void board_exit(int status);

#endif
