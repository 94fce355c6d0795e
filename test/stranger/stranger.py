# SPDX-License-Identifier: Apache-2.0
"""The stranger's bench: an independent simulation of real set-ups, judged by the real programs.

For every scene, robot and seed: simulate, write the laboratory's folder, run encode, compile, the daemon and fit on it,
compare with the truth. Prints a table of scenes and leaves every run's result in build/stranger/results.json.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: two processes share two cores

import argparse
import json
import multiprocessing
import shutil
import sys
import time
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import laboratory
import native
from judge import Programs, judge
from scenes import SCENES
from table import table

TOP = Path(__file__).resolve().parents[2]
OUT = TOP / "build/stranger"
RESERVED = 9000
"""seeds from here on are for reporting only"""

_programs: Programs | None = None


def seeds_of(text: str) -> list[int]:
    """1,4,100-119 as numbers."""
    seeds: list[int] = []
    for part in text.replace(" ", ",").split(","):
        first, _, last = part.partition("-")
        seeds += range(int(first), int(last or first) + 1)
    return seeds


def _start(top: Path) -> None:
    global _programs
    _programs = Programs(top)


def one(number: int, robot: str, seed: int, keep: Path | None) -> dict[str, Any]:
    """Simulate and judge one run."""
    assert _programs is not None
    scene = SCENES[number]
    name = f"{scene.name}_{robot}_{seed}".replace("/", "_")
    folder = (keep or OUT / f"runs.{os.getpid()}") / name
    shutil.rmtree(folder, ignore_errors=True)
    start = time.monotonic()
    try:
        run = laboratory.write(scene, robot, seed, folder)
        simulated = time.monotonic() - start
        return judge(_programs, run) | {"simulation_seconds": simulated}
    except Exception:
        said = traceback.format_exc()
        failed = {"code": -1, "failed": said.strip().splitlines()[-1]}
        return {
            "scene": scene.name, "known": scene.known, "robot": robot, "seed": seed, "error": said,
            "platform": failed, "fit": dict(failed),
        }  # fmt: skip
    finally:
        if keep is None:
            shutil.rmtree(folder, ignore_errors=True)


def save(path: Path, results: list[dict[str, Any]]) -> None:
    """Write the results by scene; called every few runs, so that a bench that is stopped leaves what it had."""
    order = {scene.name: k for k, scene in enumerate(SCENES)}
    results.sort(key=lambda r: (order[r["scene"]], r["robot"], r["seed"]))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


def wanted(words: str) -> list[tuple[int, str]]:
    """Scene numbers and robots whose "scene/robot" contains one of the words; =NAME is a whole scene or scene/robot."""
    picked = words.split()
    found = []
    for number, scene in enumerate(SCENES):
        for robot in scene.robots:
            name = f"{scene.name}/{robot}"
            if not picked or any(w[1:] in (scene.name, name) if w[0] == "=" else w in name for w in picked):
                found.append((number, robot))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("scenes", nargs="*", help="words that scene/robot contains; =NAME for one scene; default: all")
    parser.add_argument("--seeds", default="1", help="like 1, 1-5 or 100-119; from 9000 on: reserved for reports")
    parser.add_argument("--programs", type=Path, default=TOP, help="worktree whose build is judged")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--output", type=Path, default=OUT / "results.json")
    parser.add_argument("--keep", type=Path, help="leave the laboratory's folders here")
    parser.add_argument("--list", action="store_true", help="print the scenes and end")
    asked = parser.parse_args()
    runs = wanted(" ".join(asked.scenes))
    if asked.list or not runs:
        for scene in SCENES:
            print(f"{scene.name:28} {scene.motion:10} {scene.known:9} {' '.join(scene.robots)}")
        return 0 if asked.list else 2
    seeds = seeds_of(asked.seeds)
    if max(seeds) >= RESERVED:
        print(f"Seeds from {RESERVED} on are reserved for reports: never tune on what follows.")
    native.library()
    start, results = time.monotonic(), []
    tasks = [(number, robot, seed) for seed in seeds for number, robot in runs]
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(asked.jobs, context, _start, (asked.programs.resolve(),)) as pool:
        running = [pool.submit(one, *task, asked.keep and asked.keep.resolve()) for task in tasks]
        for done, future in enumerate(as_completed(running), 1):
            results.append(future.result())
            if done % 10 == 0:
                save(asked.output, results)
            if sys.stderr.isatty():
                print(f"\r{done} of {len(tasks)} runs, {time.monotonic() - start:.0f} s ", end="", file=sys.stderr)
    for folder in OUT.glob("runs.*"):
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
    save(asked.output, results)
    for line in table(results):
        print(line)
    print(f"{len(results)} runs, seeds {asked.seeds}, {time.monotonic() - start:.0f} s; {asked.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
