# SPDX-License-Identifier: Apache-2.0
"""The one exception for errors of the user. The command line prints it as one line and exits with code 2."""


class InputError(Exception):
    """A file, key, value or option is not usable. The text is one line: place, value, and remedy or allowed values."""
