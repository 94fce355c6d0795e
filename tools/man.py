# SPDX-License-Identifier: Apache-2.0
"""Manual pages and shell completions, from what the programs print of themselves:  tools/man.py FOLDER

inertiad.8 from its --help, inertiactl.1 and one inertiactl-COMMAND.1 for each command from their declarations,
inertiad-robot.toml.5 from `inertiactl help robot.toml`, inertiactl.bash, .zsh and .fish from typer.
"""

import gzip
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import typer
from typer._completion_shared import get_completion_script

from inertiad.base.version import version
from inertiad.cli.main import app

TOP = Path(__file__).resolve().parent.parent
DAEMON = TOP / "build/bin/inertiad"
COMPLETE = "_INERTIACTL_COMPLETE"


def escaped(text: str) -> str:
    """Text without meaning for roff."""
    text = text.replace("\\", r"\e").replace("-", r"\-")
    return re.sub(r"^([.'])", r"\\&\1", text, flags=re.MULTILINE)


def paragraphs(text: str) -> str:
    return "\n.PP\n".join(escaped(part.strip()) for part in text.strip().split("\n\n"))


def page(name: str, section: int, title: str, parts: list[tuple[str, str]]) -> str:
    """A page of man(7). title: one line; parts: headings with roff text."""
    head = f'.TH "{name.upper()}" {section} "" "inertiad {version()}" "inertiad"\n'
    body = [("NAME", f"{escaped(name)} \\- {escaped(title)}"), *((h, text) for h, text in parts if text)]
    return head + "".join(f".SH {heading}\n{text.rstrip()}\n" for heading, text in body)


def preformatted(text: str) -> str:
    return f".nf\n{escaped(text.rstrip())}\n.fi"


def first_sentence(text: str) -> str:
    return re.split(r"\.(?:\s|$)", " ".join(text.split("\n\n")[0].split()), maxsplit=1)[0]


# ---- inertiactl ------------------------------------------------------------------------------------------------------


def option(parameter: Any) -> str:
    """One entry of OPTIONS."""
    names = ", ".join(rf"\fB{escaped(name)}\fR" for name in (*parameter.opts, *parameter.secondary_opts))
    value = rf" \fI{escaped(parameter.metavar)}\fR" if parameter.metavar else ""
    default = parameter.default
    is_told = parameter.show_default and not callable(default) and isinstance(default, int | float | str | Path)
    told = f" Default: {default}." if is_told and not isinstance(default, bool) and str(default) else ""
    return f".TP\n{names}{value}\n{escaped(' '.join((parameter.help or '').split()) + told)}"


def command_page(name: str, command: Any) -> str:
    options = [p for p in command.params if p.opts and p.opts[0].startswith("-") and not p.hidden]
    arguments = [p for p in command.params if p.opts and not p.opts[0].startswith("-")]
    synopsis = [rf"\fBinertiactl {escaped(name)}\fR"] + (["[options]"] if options else [])
    synopsis += [rf"\fI{escaped(a.metavar or a.name.upper())}\fR" for a in arguments]
    told = [
        rf".TP{chr(10)}\fI{escaped(a.metavar or a.name.upper())}\fR{chr(10)}{escaped(a.help or '')}" for a in arguments
    ]
    parts = [
        ("SYNOPSIS", " ".join(synopsis)),
        ("DESCRIPTION", paragraphs(command.help or "")),
        ("ARGUMENTS", "\n".join(told)),
        ("OPTIONS", "\n".join(map(option, options))),
        ("EXAMPLE", escaped((command.epilog or "").removeprefix("Example: "))),
        ("SEE ALSO", r"\fBinertiactl\fR(1)"),
    ]
    return page(f"inertiactl-{name}", 1, first_sentence(command.help or name), parts)


def tool_pages() -> dict[str, str]:
    """Pages of inertiactl and its commands, by file name."""
    tool: Any = typer.main.get_command(app)
    pages = {f"inertiactl-{name}.1": command_page(name, command) for name, command in tool.commands.items()}
    listed = "\n".join(
        f".TP\n\\fBinertiactl\\-{escaped(name)}\\fR(1)\n{escaped(first_sentence(command.help or ''))}."
        for name, command in tool.commands.items()
    )
    parts = [
        ("SYNOPSIS", r"\fBinertiactl\fR [options] \fICOMMAND\fR [arguments]"),
        ("DESCRIPTION", paragraphs(tool.help or "")),
        ("COMMANDS", listed),
        ("OPTIONS", "\n".join(map(option, tool.params))),
        ("EXIT STATUS", "0: good. 1: a check failed. 2: bad usage or input, with a line on stderr for each mistake."),
        ("SEE ALSO", r"\fBinertiad\fR(8), \fBinertiad\-robot.toml\fR(5)"),
    ]
    pages["inertiactl.1"] = page("inertiactl", 1, first_sentence(tool.help or ""), parts)
    return pages


# ---- inertiad, robot.toml --------------------------------------------------------------------------------------------


def printed(*command: object) -> str:
    return subprocess.run([*map(str, command)], capture_output=True, text=True, check=True).stdout


def daemon_page() -> str:
    """From `inertiad --help`: usage and what it does, then the options as they stand."""
    usage, what, options = printed(DAEMON, "--help").split("\n", 2)
    options, _, example = options.partition("example:")
    options, _, status = options.partition("exit status:")
    parts = [
        ("SYNOPSIS", escaped(usage.removeprefix("usage: "))),
        ("DESCRIPTION", escaped(what)),
        ("OPTIONS", preformatted(options.strip("\n"))),
        ("EXAMPLE", preformatted(example.strip("\n"))),
        ("EXIT STATUS", preformatted(status.strip("\n"))),
        ("SEE ALSO", r"\fBinertiactl\fR(1), \fBinertiad\-robot.toml\fR(5)"),
    ]
    return page("inertiad", 8, first_sentence(what), parts)


def description_page() -> str:
    text = printed(sys.executable, "-m", "inertiad", "help", "robot.toml")
    parts = [
        ("DESCRIPTION", preformatted(text)),
        ("SEE ALSO", r"\fBinertiactl\-init\fR(1), \fBinertiactl\-compile\fR(1)"),
    ]
    return page("inertiad-robot.toml", 5, "description of a cable robot", parts)


def main() -> None:
    """Write all of them."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in {
        **tool_pages(),
        "inertiad.8": daemon_page(),
        "inertiad-robot.toml.5": description_page(),
    }.items():
        (folder / f"{name}.gz").write_bytes(gzip.compress(text.encode(), 9, mtime=0))
    for shell in ("bash", "zsh", "fish"):
        script = get_completion_script(prog_name="inertiactl", complete_var=COMPLETE, shell=shell)
        (folder / f"inertiactl.{shell}").write_text(script + "\n")


if __name__ == "__main__":
    main()
