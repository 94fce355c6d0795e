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

IO = ("source_socketcan", "source_file", "bus_state", "source_tracker_file", "publish", "inbox", "record", "checkpoint")
STAGE_OF = {"publish": "lcm", "inbox": "lcm", "source_tracker_file": "tracker"}
PLAINER = {
    "decode.decoded": "frames of which at least one signal was taken",
    "group.imu.complete": "samples of which every frame came",
    "group.force.complete": "samples of which every frame came",
    "group.position.complete": "samples of which every frame came",
    "motion.rows": "rows with an attitude and a velocity",
    "window.windows": "windows finished",
    "detect.changes": "payload changes: the body after explains the windows far better",
    "detect.rejected": "suspected changes that were none: the body before explains the windows as well",
    "detect.misfit": "suspected changes after which neither body explained the windows for 5 s",
    "estimate.frozen": "windows that did not reach the estimator while it was frozen",
    "busN.lines": "lines read",
    "busN.drop_reports": "lines in which the logger reports lost frames",
    "busN.comments": "lines that are comments",
    "busN.bad_stamp": "lines refused: no time stamp",
    "busN.bad_name": "lines refused: no interface name",
    "busN.bad_id": "lines refused: no CAN identifier",
    "busN.bad_data": "lines refused: data bytes",
    "busN.bad_tail": "lines refused: something behind the data",
    "busN.stray_stamp": "lines refused: a stamp far from those around it",
    "busN.error_warning": "times the controller entered error warning",
    "busN.error_passive": "times the controller entered error passive",
    "busN.bus_off": "times the controller went bus-off",
    "busN.restarted": "times the controller was restarted",
    "tracker.stray_time": "rows refused: a time far from those around it",
    "tracker.positions": "positions handed on",
    "record.dropped": "messages that are not in the record",
}
"""meaning of counters whose comment in the code says it only beside its neighbours"""


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
    exits = (
        "Exit codes: 0 end of input or SIGTERM, 1 nothing was bound, 2 bad usage or input, 3 it could not start now."
    )
    return f"# The daemon\n`inertiad -h` prints:\n\n```text\n{(said.stdout + said.stderr).rstrip()}\n```\n\n{exits}\n"


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
    text = re.sub(r"\A# Messages\n", "# Messages\n", (folder / "README.md").read_text(encoding="utf-8"))
    lines = [text, "## Types", ""]
    for file in sorted(folder.glob("*.lcm")):
        said = [x for x in file.read_text(encoding="utf-8").splitlines() if not x.startswith(("// SPDX", "package"))]
        lines += [f"### {file.stem}", "", "```c", "\n".join(said).strip(), "```", ""]
    return "\n".join(lines)


# ---- counters --------------------------------------------------------------------------------------------------------


def _comment_of(path: str, types: dict[str, dict[str, headers.Member]]) -> str:
    """Comment of a member such as estimator.rls.n_updates of the pipeline."""
    kind, said = "ipe_pipeline_t", ""
    for part in re.sub(r"\[\w+\]", "", path).split("."):
        member = types[kind][part]
        kind, said = member.type, member.comment
    return said


def _flags(name: str) -> str:
    said = []
    if name in counters.REJECTED:
        said.append("rows lost or refused")
    if counters.is_bad(name):
        said.append("0 on a good run")
    return ", ".join(said)


def _pipeline_counters(core: Path) -> Iterator[tuple[str, str]]:
    types = {name: found for file in core.glob("*.h") for name, found in headers.members(file).items()}
    table = (core / "counter_table.c").read_text(encoding="utf-8")
    for name, path in re.findall(r'\{"([\w.]+)", AT\(([^)]+)\)', table):
        yield name, _comment_of(path, types)


def _daemon_counters(io: Path) -> Iterator[tuple[str, str]]:
    shared = headers.members(io / "bus_counts.h")["ipe_bus_counts_t"]
    for source in IO:
        own = {n: m for found in headers.members(io / f"{source}.h").values() for n, m in found.items()} | shared
        body = (io / f"{source}.c").read_text(encoding="utf-8").partition(f"ipe_{source}_counter(")[2]
        for cause, value in re.findall(r'\{"(\w+)",\s*([^{}]+?)\}', body.partition("\n}\n")[0]):
            members = re.findall(r"\bn_\w+", value)
            stage = STAGE_OF.get(source, "busN" if source.startswith(("source", "bus")) else source)
            yield f"{stage}.{cause}", own[members[0]].comment if members and members[0] in own else ""


def counter_page(firmware: Path) -> str:
    """Every counter of the pipeline and of the daemon, with the comment at its place in the code."""
    lines = [
        "# Counters",
        "`HEALTH`, the daemon's last lines, `estimate.json` and `verify` name losses by these counters: stage, then",
        "cause. A row is one aligned sample of all sensors.",
        "",
    ]
    for title, found in (
        ("Pipeline", _pipeline_counters(firmware / "core")),
        ("Buses, network, files", _daemon_counters(firmware / "io")),
    ):
        lines += [f"## {title}", "", "| counter | meaning | what it tells |", "|---|---|---|"]
        lines += [
            f"| `{name}` | {cell(PLAINER.get(name, meaning))} | {_flags(name)} |"
            for name, meaning in dict(found).items()
        ]
        lines.append("")
    return "\n".join(lines)
