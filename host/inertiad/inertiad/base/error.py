# SPDX-License-Identifier: Apache-2.0
"""The one exception for what a user can get wrong. The command line prints it as one line and exits with code 2."""


class InputError(Exception):
    """A file, key, value or option is not usable. The text is one line: where, what, and what is allowed."""
