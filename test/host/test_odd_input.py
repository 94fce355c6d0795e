# SPDX-License-Identifier: Apache-2.0
"""Odd input to fit, calibrate, report and sync: a result, or one line; no traceback, no warning, no unconverged result.

More of them: python test/host/odd_inputs.py 1000 500
"""

import odd_inputs
import pytest

SEEDS = range(28)


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> odd_inputs.Good:
    return odd_inputs.good_run(tmp_path_factory.mktemp("good"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_odd_input_gives_a_result_or_one_line(good, tmp_path, seed):
    assert odd_inputs.judge(odd_inputs.command_of(seed), odd_inputs.make(good, tmp_path, seed)) == ""
