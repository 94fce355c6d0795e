# SPDX-License-Identifier: Apache-2.0
"""No test here reads MF4, and python-can's import of the package for it takes a minute in an emulated guest."""

from inertiad.base import python_can

python_can.load()
