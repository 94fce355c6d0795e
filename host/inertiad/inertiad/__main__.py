# SPDX-License-Identifier: Apache-2.0
"""python -m inertiad = inertiactl."""

from inertiad.cli.main import main

if __name__ == "__main__":
    main()
