// SPDX-License-Identifier: Apache-2.0
/// Arm MPS2+ with the AN500 image, a Cortex-M7 with a double-precision FPU, as QEMU emulates it (-M mps2-an500).
///
/// Start-up, the timer, an interrupt of the NVIC that stands for the CAN controller's, files of the host by semihosting
/// (Arm, Semihosting for AArch32 and AArch64, 2.0): the input `tape`, the result `estimates`, in QEMU's working directory.
/// Sources: Arm, Application Note AN500 (memory map); Armv7-M Architecture Reference Manual (NVIC, CPACR).
#include "board.h"

#include <stdbool.h>
#include <string.h>

#define CPACR (*(volatile uint32_t*)0xE000ED88U)
#define NVIC_ISER0 (*(volatile uint32_t*)0xE000E100U)
#define NVIC_ISPR0 (*(volatile uint32_t*)0xE000E200U)
#define TIMER0_CTRL (*(volatile uint32_t*)0x40000000U)
#define TIMER0_VALUE (*(volatile uint32_t*)0x40000004U)
#define TIMER0_RELOAD (*(volatile uint32_t*)0x40000008U)

enum { CAN_INTERRUPT = 7, EXCEPTIONS = 16, CHUNK = 4096, PAINT = 0xA5 };
enum { SYS_OPEN = 0x01, SYS_WRITE = 0x05, SYS_READ = 0x06, SYS_EXIT_EXTENDED = 0x20, EXIT = 0x20026 };
enum { MODE_RB = 1, MODE_WB = 5 };

extern uint32_t ld_data_from[], ld_data_start[], ld_data_end[], ld_bss_start[], ld_bss_end[];
extern uint8_t ld_stack_bottom[], ld_stack_top[];
int main(void);
void reset(void);

static uintptr_t tape, estimates;
static uint8_t waiting[CHUNK];
static size_t n_waiting, next;
static char written[CHUNK];
static size_t n_written;

static uintptr_t semihost(uintptr_t operation, const void* argument)
{
    register uintptr_t r0 __asm__("r0") = operation;
    register const void* r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static uintptr_t open_file(const char* name, uintptr_t mode)
{
    const uintptr_t argument[] = {(uintptr_t)name, mode, strlen(name)};
    return semihost(SYS_OPEN, argument);
}

static void write_out(void)
{
    const uintptr_t argument[] = {estimates, (uintptr_t)written, n_written};
    (void)semihost(SYS_WRITE, argument);
    n_written = 0;
}

static bool fill(void)
{
    const uintptr_t argument[] = {tape, (uintptr_t)waiting, sizeof waiting};
    n_waiting = sizeof waiting - semihost(SYS_READ, argument);
    next = 0;
    return n_waiting > 0;
}

size_t board_read(void* bytes, size_t n)
{
    uint8_t* to = bytes;
    size_t done = 0;
    while (done < n && (next < n_waiting || fill())) {
        const size_t part = n - done < n_waiting - next ? n - done : n_waiting - next;
        memcpy(to + done, waiting + next, part);
        done += part, next += part;
    }
    return done;
}

void board_write(const char* text, size_t n)
{
    if (n_written + n > sizeof written) { write_out(); }
    memcpy(written + n_written, text, n);
    n_written += n;
}

void board_raise_interrupt(void)
{
    NVIC_ISPR0 = 1U << CAN_INTERRUPT;
    __asm__ volatile("dsb\n isb" ::: "memory");
}

uint32_t board_ticks(void)
{
    return ~TIMER0_VALUE;
}

void board_mark_stack(void)
{
    uint8_t* here;
    __asm__ volatile("mov %0, sp" : "=r"(here));
    for (volatile uint8_t* p = ld_stack_bottom; p < here; ++p) { *p = PAINT; }
}

size_t board_stack_used(void)
{
    const uint8_t* p = ld_stack_bottom;
    while (p < ld_stack_top && *p == PAINT) { ++p; }
    return (size_t)(ld_stack_top - p);
}

_Noreturn void board_exit(int status)
{
    write_out();
    const uintptr_t argument[] = {EXIT, (uintptr_t)status};
    (void)semihost(SYS_EXIT_EXTENDED, argument);
    for (;;) {}
}

void reset(void)
{
    CPACR |= 0xFU << 20;  // full access to the FPU, before any instruction of it
    __asm__ volatile("dsb\n isb" ::: "memory");
    for (uint32_t *to = ld_data_start, *from = ld_data_from; to < ld_data_end;) { *to++ = *from++; }
    for (uint32_t* to = ld_bss_start; to < ld_bss_end;) { *to++ = 0; }
    TIMER0_RELOAD = UINT32_MAX;
    TIMER0_VALUE = UINT32_MAX;
    TIMER0_CTRL = 1;
    NVIC_ISER0 = 1U << CAN_INTERRUPT;
    tape = open_file("tape", MODE_RB);
    estimates = open_file("estimates", MODE_WB);
    board_exit(main());
}

/// Any fault ends the run with a status of its own.
static void fault(void)
{
    board_exit(3);
}

typedef void (*handler_t)(void);
__attribute__((section(".vectors"), used)) static const handler_t vectors[EXCEPTIONS + CAN_INTERRUPT + 1] = {
    (handler_t)ld_stack_top, reset, fault, fault, fault, fault, fault, [EXCEPTIONS + CAN_INTERRUPT] = board_interrupt,
};
