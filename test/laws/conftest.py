# SPDX-License-Identifier: Apache-2.0
"""Numbers that the laws measure, printed at the end of a run: the `measured` fixture."""

import pytest

LINES: list[str] = []


@pytest.fixture
def measured():
    """Call with a line of text to have it printed."""
    return LINES.append


def pytest_terminal_summary(terminalreporter):
    for line in LINES:
        terminalreporter.write_line(line)
