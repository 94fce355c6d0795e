# SPDX-License-Identifier: Apache-2.0
"""The one exception for errors of the user. The command line prints its lines and exits with code 2."""


class InputError(Exception):
    """A file, key, value or option is not usable. Each line: place, value, and remedy or allowed values."""

    def __init__(self, *lines: str) -> None:
        super().__init__(*lines)
        self.lines = lines

    def __str__(self) -> str:
        """One line: the first, and the number of others."""
        more = f" (and {len(self.lines) - 1} more)" if len(self.lines) > 1 else ""
        return f"{self.lines[0]}{more}"
