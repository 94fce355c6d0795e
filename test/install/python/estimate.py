# SPDX-License-Identifier: Apache-2.0
"""A Python program on the installed package, the same as c/estimate.c:  estimate.py robot.cfg can.log tracker.csv"""

import sys
from pathlib import Path

import numpy as np

import inertiad_core as core
from inertiad.run import canlog

config, log, tracker = map(Path, sys.argv[1:])
pipeline = core.Pipeline(core.Config(config.read_bytes()))
positions = [line.split(",") for line in tracker.read_text().splitlines()[1:]]
waiting = [(round(1e9 * float(t)), np.array(p, dtype=float)) for t, *p in positions][::-1]

frames = canlog.read(log)
for i, t_ns in enumerate(frames.t_ns):
    while waiting and waiting[-1][0] <= t_ns:
        pipeline.push_position(*waiting.pop())
    pipeline.push_frame(int(t_ns), 0, int(frames.can_id[i]), frames.data[i, : frames.length[i]].tobytes())
    pipeline.drain()
pipeline.flush()
pipeline.drain()
print(*(float(value).hex() for value in pipeline.estimate["theta"]), sep="\n")
