# SPDX-License-Identifier: Apache-2.0
"""Pages of reference as Markdown: commands, keys of robot.toml, messages, counters; each from what the programs use."""

import html
import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import headers
import typer

from inertiad.base import counters
from inertiad.cli.main import app
from inertiad.robot import reference as keys

IO = (
    *("source_socketcan", "source_file", "bus_state", "source_tracker_file", "lock_step", "publish", "inbox", "record"),
    "checkpoint",
)
STAGE_OF = {"publish": "lcm", "inbox": "lcm", "source_tracker_file": "tracker"}
LATE = ("force", "position")
"""sensors that may be late: rows are those of the IMU"""


def cell(text: str) -> str:
    """Text for a cell of a table."""
    return " ".join(html.escape(text, quote=False).replace("|", "&#124;").replace("[", "&#91;").split())


def code(text: str) -> str:
    """Text as code in a cell of a table."""
    return f"<code>{cell(text)}</code>"


# ---- commands --------------------------------------------------------------------------------------------------------


def _parameters(command: Any) -> Iterator[str]:
    yield "| argument or option | meaning | default |\n|---|---|---|"
    for parameter in command.params:
        if parameter.name == "help":
            continue
        metavar = parameter.metavar or ""
        if parameter.param_type_name == "argument":
            name = metavar or parameter.name.upper()
        else:
            name = ", ".join(parameter.opts) + (f" {metavar}" if metavar and not parameter.is_flag else "")
        if parameter.required:
            default = "required"
        else:
            value = parameter.default
            is_said = isinstance(value, (str, int, float, Path)) and not isinstance(value, bool) and value != ""
            default = f"default {value}" if is_said else ""
        yield f"| {code(name)} | {cell(parameter.help or '')} | {cell(default)} |"


def commands() -> str:
    """Every command of inertiactl with its options, and the daemon's help."""
    command: Any = typer.main.get_command(app)
    lines = ["# Commands", "Made from the programs' own help: `inertiactl COMMAND -h`.", ""]
    lines += [
        "Exit codes of `inertiactl`: 0 good, 1 a check failed, 2 bad usage or input. `-o -` and `--json -` write to"
    ]
    lines += ["stdout; messages for people go to stderr.", ""]
    for name, one in command.commands.items():
        lines += [f"## {name}", "", html.escape(one.help or "", quote=False).replace("[", "\\["), ""]
        lines += [*_parameters(one), ""]
        if one.epilog:
            lines += ["```sh", one.epilog.removeprefix("Example: "), "```", ""]
    return "\n".join(lines)


def daemon(program: Path) -> str:
    """The daemon's help."""
    said = subprocess.run([program, "-h"], capture_output=True, text=True, check=True)
    return f"# The daemon\n`inertiad -h` prints:\n\n```text\n{said.stdout.rstrip()}\n```\n"


# ---- keys ------------------------------------------------------------------------------------------------------------


def _keys_of(path: str, table: keys.Schema, tables: dict[str, keys.Schema], leave: set[str]) -> Iterator[str]:
    yield from ("| key | allowed | default | meaning |", "|---|---|---|---|")
    for name, key in table["properties"].items():
        if name in leave or (keys.table_of(key, tables) is not None and (path == "" or "description" not in key)):
            continue
        is_required = name in table.get("required", [])
        default = "required" if is_required else code(keys.toml_value(key["default"])) if "default" in key else ""
        yield f"| `{name}` | {code(keys.allowed(key, tables))} | {default} | {cell(keys.meaning(key))} |"


def _tables(path: str, table: keys.Schema, brackets: str, tables: dict[str, keys.Schema]) -> Iterator[str]:
    known = set(tables["Cables"]["properties"]) if path == "cable" else set()
    yield from ("", f"## {cell(brackets.format(path))}", "", cell(table["description"]), "")
    yield from _keys_of(path, table, tables, known)
    for name, key in table["properties"].items():
        found = keys.table_of(key, tables)
        if found is not None and "description" not in key and name not in known:
            yield from _tables(f"{path}.{name}", *found, tables)


def robot_keys() -> str:
    """Every key of robot.toml, from its JSON schema."""
    schema = keys.schema()
    tables = schema["$defs"]
    whole = {"properties": {n: k for n, k in schema["properties"].items() if n != "signals"}}
    whole["required"] = schema["then"]["required"]
    lines = ["# Keys of robot.toml", cell(keys.INTRODUCTION), ""]
    lines += [
        "Also: `inertiactl help robot.toml`; `inertiactl schema` writes the [JSON schema](robot.schema.json).",
        "",
    ]
    lines += ["## Top level", "", *_keys_of("", whole, tables, set())]
    signals = schema["properties"]["signals"]
    lines += ["", "## &#91;signals&#93;", "", cell(signals["description"]), ""]
    lines += ["Quantities: " + ", ".join(f"`{name}`" for name in signals["propertyNames"]["enum"]) + "."]
    for name, key in schema["properties"].items():
        found = keys.table_of(key, tables)
        if found is not None:
            lines += _tables(name, *found, tables)
    return "\n".join(lines) + "\n"


def robot_schema() -> str:
    """The JSON schema as `inertiactl schema` writes it."""
    return json.dumps(keys.schema(), indent=2, ensure_ascii=False) + "\n"


# ---- messages --------------------------------------------------------------------------------------------------------


def messages(folder: Path) -> str:
    """The README of the message types, and each type as it is defined."""
    lines = [(folder / "README.md").read_text(encoding="utf-8"), "## Types", ""]
    for file in sorted(folder.glob("*.lcm")):
        said = [x for x in file.read_text(encoding="utf-8").splitlines() if not x.startswith(("// SPDX", "package"))]
        lines += [f"### {file.stem}", "", "```c", "\n".join(said).strip(), "```", ""]
    return "\n".join(lines)


# ---- counters --------------------------------------------------------------------------------------------------------


class _Comments:
    """Comments of the members, constants and functions that counters are read from."""

    def __init__(self, firmware: Path) -> None:
        files = [file for folder in ("core", "io", "app") for file in sorted((firmware / folder).glob("*.h"))]
        self.types = {name: found for file in files for name, found in headers.members(file).items()}
        text = "\n".join(file.read_text(encoding="utf-8") for file in files)
        self.constants = dict(re.findall(r"^ +(IPE_\w+)(?: = \d+)?,? *///< (.*)$", text, re.MULTILINE))
        functions = re.findall(r"^/// ([^\n]*)\.\n(\w+) (ipe_\w+)\(", text, re.MULTILINE)
        self.functions = {name: (kind, said[0].lower() + said[1:]) for said, kind, name in functions}

    def of(self, kind: str, path: str) -> str:
        """Comment of a member such as estimator.rls.n_updates, and of the constant that is its index."""
        said = ""
        for part in re.sub(r"\[\w+\]", "", path).split("."):
            member = self.types[kind][part]
            kind, said = member.type, member.comment
        index = re.search(r"\[(IPE_CANDUMP_\w+)\]", path)
        return f"{said}: {self.constants[index[1]]}" if index else said

    def of_value(self, kind: str, value: str) -> str:
        """Comment of what an expression reads: a member of the object or of a function's result, or the function."""
        if called := re.search(r"(ipe_\w+)\(.*\)(?:\.(\w+))?", value):
            result, said = self.functions[called[1]]
            return self.of(result, called[2]) if called[2] else said
        return self.of(kind, re.search(r"\w+->([\w.\[\]]+)", value)[1])  # type: ignore[index]


def _flags(name: str) -> str:
    said = []
    if name in counters.REJECTED:
        said.append("rows lost or refused")
    if counters.is_bad(name):
        said.append("0 on a good run")
    return ", ".join(said)


def _pipeline_counters(firmware: Path, comments: _Comments) -> Iterator[tuple[str, str]]:
    table = (firmware / "core/counter_table.c").read_text(encoding="utf-8")
    for name, path in re.findall(r'\{"([\w.]+)", AT\(([^)]+)\)', table):
        yield name, comments.of("ipe_pipeline_t", path)


def _source_counters(firmware: Path, comments: _Comments) -> Iterator[tuple[str, str]]:
    """Of the modules of io, each with a table of its own."""
    for source in IO:
        body = (firmware / f"io/{source}.c").read_text(encoding="utf-8").partition(f"ipe_{source}_counter(")[2]
        stage = STAGE_OF.get(source, "busN" if source.startswith(("source", "bus")) else source)
        for cause, value in re.findall(r'\{"(\w+)",\s*([^{}]+?)\}', body.partition("\n}\n")[0]):
            yield f"{stage}.{cause}", comments.of_value(f"ipe_{source}_t", value)


def _daemon_counters(firmware: Path, comments: _Comments) -> Iterator[tuple[str, str]]:
    """Of the daemon itself."""
    text = (firmware / "app/health.c").read_text(encoding="utf-8")
    for stage, cause, value in re.findall(r'ipe_counters_add\(&d->counters, ([^;]+?), "(\w+)",\s*([^;]+)\);', text):
        if stage.startswith('"'):
            yield f"{stage[1:-1]}.{cause}", comments.of_value("daemon_t", value)
            continue
        is_late = "lateness" in cause
        for sensor in LATE if is_late else ("imu", *LATE):
            yield f"{sensor}.{cause}", comments.of_value("daemon_t", value) + (", us" if is_late else "")


def counter_page(firmware: Path) -> str:
    """Every counter of the pipeline and of the daemon, with the comment at its place in the code."""
    lines = [
        "# Counters",
        "`HEALTH`, the daemon's last lines, `estimate.json` and `verify` name losses by these counters: stage, then",
        "cause. A row is one aligned sample of all sensors. A window is 0.4 s of rows, by default.",
        "",
    ]
    comments = _Comments(firmware)
    for title, found in (
        ("Pipeline", _pipeline_counters(firmware, comments)),
        ("Buses, network, files", _source_counters(firmware, comments)),
        ("Sensors, commands, clock", _daemon_counters(firmware, comments)),
    ):
        lines += [f"## {title}", "", "| counter | meaning | judged |", "|---|---|---|"]
        lines += [f"| `{name}` | {cell(meaning)} | {_flags(name)} |" for name, meaning in dict(found).items()]
        lines.append("")
    return "\n".join(lines)
