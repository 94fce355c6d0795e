# SPDX-License-Identifier: Apache-2.0
"""Console blocks of a page, run as a reader would type them, and what they print put below each command.

```console
$ inertiactl compile robot.toml -o robot.cfg
```
A page is one shell in a folder of its own, in a network of its own. A command that fails ends the build. Blocks of
other languages are not run: they need hardware.
"""

import os
import re
import subprocess
from pathlib import Path

BLOCK = re.compile(r"^```console\n(.*?)^```$", re.DOTALL | re.MULTILINE)
NETWORK = 'ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && exec "$@"'
PATIENCE = 600
"""s for one page's commands on a loaded machine"""


class SessionError(Exception):
    """A command of a page failed."""


def commands(block: str) -> list[str]:
    """Commands of a console block; a line that ends with a backslash goes on in the next."""
    found: list[str] = []
    for line in block.splitlines():
        if line.startswith("$ "):
            found.append(line[2:])
        elif found and found[-1].endswith("\\"):
            found[-1] += "\n" + line
        else:
            raise SessionError(f'"{line}": allowed in a console block: lines that begin with "$ "')
    return found


def _own_network() -> list[str]:
    """Before a command: a network of its own. SessionError: this machine allows none."""
    refused = ""
    for command in (["unshare", "--net"], ["unshare", "--map-root-user", "--net"]):
        done = subprocess.run([*command, "true"], capture_output=True, text=True)
        if done.returncode == 0:
            return command
        refused = done.stderr.strip()
    raise SessionError(
        f"commands of the pages run in a network of their own: {refused}; run as root, or allow user namespaces"
    )


def _prepare(folder: Path, top: Path) -> dict[str, str]:
    """What a reader finds in the repository's folder, as links; the environment of the shell."""
    folder.mkdir(parents=True)
    for name in ("firmware", "host", "build", ".venv"):
        (folder / name).symlink_to(top / name)
    path = f"{top / 'build/bin'}:{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "COLUMNS": "100", "OPENBLAS_NUM_THREADS": "1", "TERM": "dumb"}


def outputs(folder: Path, top: Path, typed: list[str], title: str) -> list[str]:
    """What each command prints, stdout and stderr together. SessionError: one failed."""
    mark = f"-- end of a command {os.getpid()} --"
    own_network = _own_network()
    script = "".join(f'{{ {one}\n}} 2>&1\necho "{mark}$?"\n' for one in typed)
    isolated = [*own_network, "sh", "-c", NETWORK, "sh", "bash", "-c", script]
    environment = _prepare(folder, top)
    done = subprocess.run(isolated, cwd=folder, env=environment, capture_output=True, text=True, timeout=PATIENCE)
    parts = re.split(rf"^{mark}(\d+)\n", done.stdout, flags=re.MULTILINE)
    printed, codes = parts[:-1:2], parts[1::2]
    for one, text, code in zip(typed, printed, codes, strict=False):
        if code != "0":
            raise SessionError(f"{title}: $ {one}\n{text}exit code {code}")
    if len(codes) != len(typed):
        raise SessionError(f"{title}: the shell ended early: {done.stderr[-500:].strip()}")
    return printed


def with_outputs(text: str, folder: Path, top: Path, title: str) -> str:
    """A page's text with the output of each command of its console blocks below it."""
    blocks = [commands(block) for block in BLOCK.findall(text)]
    typed = [one for block in blocks for one in block]
    if not typed:
        return text
    said = iter(outputs(folder, top, typed, title))

    def shown(block: re.Match[str]) -> str:
        lines = [f"$ {one}\n{next(said)}" for one in commands(block[1])]
        return "```console\n" + "".join(line if line.endswith("\n") else line + "\n" for line in lines) + "```"

    return BLOCK.sub(shown, text)
