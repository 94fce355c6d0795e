# SPDX-License-Identifier: Apache-2.0
"""Pages of the programming interfaces as Markdown, from the comments of headers and the docstrings of modules."""

import ast
import html
import re
from collections.abc import Iterator
from pathlib import Path

import headers

FIRST = ("pipeline", "config", "estimate", "parameter_gate", "types", "body", "regressor", "consistency")
"""what a program of its own begins with, in this order"""
_ARRAY = re.compile(r"Annotated\[NDArray\[numpy\.(\w+)\], dict\(shape=\(([^()]*)\)[^()]*\)\]")


def _comment(text: str) -> Iterator[str]:
    """A comment as Markdown: lines that are set in stay as they are."""
    is_set_in = False
    for line in text.splitlines():
        indented = line.startswith("  ")
        if indented != is_set_in and line.strip():
            yield from ("", "```text" if indented else "```", "") if not is_set_in else ("```", "")
            is_set_in = indented
        yield line if is_set_in else html.escape(line, quote=False).replace("[", "\\[").replace("*", "\\*")
    if is_set_in:
        yield "```"


def _header(found: headers.Header, language: str) -> Iterator[str]:
    yield from (f"## {found.path.name}", "", *_comment(found.comment), "")
    for one in found.declarations:
        yield from (f"### `{one.name}`", "", *_comment(one.comment), "", f"```{language}", one.code, "```", "")


def c_page(core: Path) -> str:
    """The core's headers."""
    known = sorted(core.glob("*.h"), key=lambda p: (FIRST.index(p.stem) if p.stem in FIRST else len(FIRST), p.stem))
    lines = [
        "# C",
        "Headers of `firmware/core`: no heap, no system calls. To link an installation: `pkg-config inertiad`.",
        "",
    ]
    for path in known:
        lines += _header(headers.read(path), "c")
    return "\n".join(lines)


def cpp_page(include: Path) -> str:
    """The C++ layer's headers."""
    lines = ["# C++", "Headers of `host/eigen/include/inertiad`: the core seen through Eigen's types.", ""]
    for path in sorted(include.glob("*.hpp")):
        lines += _header(headers.read(path), "cpp")
    return "\n".join(lines)


# ---- Python ----------------------------------------------------------------------------------------------------------


def _plain(annotation: str) -> str:
    """A type with its array's shape in place of the binding's description of it."""

    def shaped(found: re.Match[str]) -> str:
        shape = ", ".join("N" if part == "None" else part for part in re.findall(r"None|\d+", found[2]))
        return f"Array[{shape}]"

    return re.sub(r"NDArray\[numpy\.\w+\]", "Array", _ARRAY.sub(shaped, annotation))


def _signature(node: ast.FunctionDef) -> str:
    arguments, result = ast.unparse(node.args), ast.unparse(node.returns) if node.returns else "None"
    return f"{node.name}({_plain(arguments)}) -> {_plain(result)}"


def _is_public(node: ast.AST) -> bool:
    return isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_")


def _said(node: ast.FunctionDef | ast.ClassDef | ast.Module) -> Iterator[str]:
    yield from _comment(ast.get_docstring(node) or "")


def _fields(node: ast.ClassDef) -> Iterator[str]:
    """Fields of a class with the text below each."""
    for at, field in enumerate(node.body):
        if isinstance(field, ast.AnnAssign):
            below = node.body[at + 1] if at + 1 < len(node.body) else None
            is_said = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
            said = f" — {html.escape(str(below.value.value), quote=False)}" if is_said else ""
            yield f"- `{ast.unparse(field.target)}: {ast.unparse(field.annotation)}`{said.replace('[', chr(92) + '[')}"


def _class(node: ast.ClassDef) -> Iterator[str]:
    yield from (f"### class `{node.name}`", "", *_said(node), "", *_fields(node), "")
    for method in node.body:
        if isinstance(method, ast.FunctionDef) and (_is_public(method) or method.name == "__init__"):
            is_value = any(isinstance(d, ast.Name) and d.id == "property" for d in method.decorator_list)
            head = f"{method.name}" if is_value else _signature(method)
            yield from ("```python", head, "```", "", *_said(method), "")


def _module(name: str, path: Path) -> Iterator[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    public = [node for node in tree.body if _is_public(node)]
    if not public:
        return
    yield from (f"## {name}", "", *_said(tree), "")
    for node in public:
        if isinstance(node, ast.ClassDef):
            yield from _class(node)
        elif isinstance(node, ast.FunctionDef):
            yield from (f"### `{node.name}`", "", "```python", _signature(node), "```", "", *_said(node), "")


def core_page(typings: Path) -> str:
    """The bindings of the core, from their type stubs."""
    lines = ["# Python: the core", "Bindings of the C core and of the C++ layer; `Array`: numpy, of 64-bit floats.", ""]
    for path in sorted(typings.glob("*.pyi")):
        lines += _module(path.stem, path)
    return "\n".join(lines)


def package_page(package: Path, folders: tuple[str, ...]) -> str:
    """Public functions and classes of the host package."""
    lines = ["# Python: the package", "What `inertiactl` is made of. Until 1.0 a minor version may change it.", ""]
    for folder in folders:
        for path in sorted((package / folder).glob("*.py")):
            if not path.stem.startswith("_"):
                lines += _module(f"inertiad.{folder}.{path.stem}", path)
    return "\n".join(lines)
