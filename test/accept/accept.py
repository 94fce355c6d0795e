# SPDX-License-Identifier: Apache-2.0
"""The acceptance list T1-T15: limit, measured, PASS or FAIL, on seeds from 1000 on, which nothing was tuned on.

Accuracies are medians over trials of |estimate - truth|: m in %, rho x/y/z in mm, J x/y/z about the CoG in %.
build/accept/ keeps the table (accept.txt, accept.json) and the pictures (coverage.png, pickup.png, paper.png).
Usage: accept.py [T6 T8 ...]. Exit 1 if one fails, 2 on bad usage.
"""

import json
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed

import accuracy
import change
import core
from verdict import HEAD, Verdict, scratch

WORKERS = 2
TABLE: dict[str, tuple[Callable[[], Verdict | list[Verdict]], ...]] = {
    "T1": (core.t1,),
    "T2": (accuracy.t2,),
    "T3": (core.t3,),
    "T4": (core.t4,),
    "T5": (core.t5,),
    "T6": (accuracy.t6,),
    "T7": (accuracy.t7,),
    "T8": (accuracy.t8,),
    "T9": (accuracy.t9,),
    "T10": (accuracy.t10,),
    "T11": (accuracy.t11,),
    "T12": (change.t12, core.t12_noise),
    "T13": (accuracy.t13,),
    "T14": (core.t14,),
    "T15": (core.t15, core.t15_targets),
}


def measure(name: str) -> list[Verdict]:
    """The lines of one test."""
    found: list[Verdict] = []
    for test in TABLE[name]:
        result = test()
        found += result if isinstance(result, list) else [result]
    return found


def main(wanted: list[str]) -> int:
    """Print lines as they are done, keep them in the list's order. 1 if one failed."""
    unknown = [name for name in wanted if name not in TABLE]
    if unknown:
        print(f"accept: {unknown[0]}: allowed: {', '.join(TABLE)}", file=sys.stderr)
        return 2
    names = wanted or list(TABLE)
    start = time.monotonic()
    print(HEAD, flush=True)
    with ProcessPoolExecutor(WORKERS) as pool:
        running = {pool.submit(measure, name): name for name in names}
        results = {}
        for done in as_completed(running):
            results[running[done]] = done.result()
            print(*done.result(), sep="\n", flush=True)
    verdicts = [verdict for name in names for verdict in results[name]]
    n_failed = sum(v.good is False for v in verdicts)
    last = f"{len(verdicts) - n_failed} of {len(verdicts)} lines hold, {time.monotonic() - start:.0f} s"
    print(last)
    scratch("accept.txt").write_text("\n".join([HEAD, *map(str, verdicts), last, ""]), encoding="utf-8")
    scratch("accept.json").write_text(json.dumps([v.as_dict() for v in verdicts], indent=1) + "\n", encoding="utf-8")
    return 1 if n_failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
