# SPDX-License-Identifier: Apache-2.0
"""inertiad as a wheel installs it: this process becomes the daemon."""

import os
import sys
from typing import NoReturn

from inertiad.base import installation
from inertiad.base.error import InputError


def main() -> NoReturn:
    """Replace this process by the packaged daemon, with the same arguments."""
    try:
        path = installation.daemon()
    except InputError as error:
        sys.exit("\n".join(error.lines))
    os.execv(path, ["inertiad", *sys.argv[1:]])
