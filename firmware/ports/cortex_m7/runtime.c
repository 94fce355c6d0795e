// SPDX-License-Identifier: Apache-2.0
/// The two functions of the C library that would bring the heap with them, in the form that the core needs.
#include <stdarg.h>
#include <stddef.h>

#include "board.h"

int snprintf(char* text, size_t size, const char* format, ...);
_Noreturn void __assert_func(const char* file, int line, const char* function, const char* expression);

/// The format itself, and for "%s" alone its text: why a configuration is refused, without the numbers.
int snprintf(char* text, size_t size, const char* format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    const char* from =
        format[0] == '%' && format[1] == 's' && format[2] == '\0' ? va_arg(arguments, const char*) : format;
    va_end(arguments);
    size_t n = 0;
    for (; from[n] != '\0'; ++n) {
        if (n + 1 < size) { text[n] = from[n]; }
    }
    if (size > 0) { text[n < size ? n : size - 1] = '\0'; }
    return (int)n;
}

_Noreturn void __assert_func(const char* file, int line, const char* function, const char* expression)
{
    (void)file, (void)line, (void)function, (void)expression;
    board_exit(4);
}
