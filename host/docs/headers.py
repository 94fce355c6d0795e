# SPDX-License-Identifier: Apache-2.0
"""C and C++ headers as declarations with the comments above them, bodies of functions and private members left out."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_KEPT = re.compile(r"\b(namespace|struct|class|enum|union)\b|extern \"C\"")
_SKIPPED = re.compile(r"$|#(?!define \w+ \S)|extern \"C\"|namespace\b|\}$")
_NAME = (
    re.compile(r"^typedef\b.*\}\s*(\w+)\s*;", re.DOTALL),
    re.compile(r"^enum\s*\{\s*(\w+)"),
    re.compile(r"^(?:template\s*<[^{;]*?>\s*)?(?:struct|class|enum class|enum|union)\s+(\w+)", re.DOTALL),
    re.compile(r"^#define\s+(\w+)"),
    re.compile(r"^(?:using|typedef)\s+(\w+)\s*="),
    re.compile(r"(~?\w+|operator\S+)\s*\("),
    re.compile(r"(\w+)\s*(?:\[[^\]]*\]\s*)*(?:=|\{|;)"),
)


@dataclass(frozen=True)
class Declaration:
    """One declaration of a header."""

    name: str
    comment: str
    code: str


@dataclass(frozen=True)
class Header:
    """A header."""

    path: Path
    comment: str
    declarations: list[Declaration]


def _after_body(text: str, start: int) -> int:
    """Index after the brace that closes the one at start."""
    depth = 0
    for at in range(start, len(text)):
        depth += {"{": 1, "}": -1}.get(text[at], 0)
        if depth == 0:
            return at + 1
    raise ValueError(f"a brace is not closed: {text[start : start + 40]!r}")


def _without_comments(text: str) -> str:
    return re.sub(r"//[^\n]*", lambda found: " " * len(found[0]), text)


def without_bodies(text: str) -> str:
    """Text of a header with a semicolon in place of each function's body and its constructor's initialisers."""
    bare, out, at, begin = _without_comments(text), [], 0, 0
    while at < len(text):
        if bare[at] == "{" and "(" in bare[begin:at] and not _KEPT.search(bare[begin:at]):
            head = "".join(out)
            initialiser = re.search(r"\)(?:\s*noexcept)?\s*(\s:[^:])[^;{}]*$", _without_comments(head))
            out = [(head[: initialiser.start(1)] if initialiser else head).rstrip(), ";"]
            at = _after_body(bare, at)
            if at < len(text) and bare[at] == ";":
                at += 1
            begin = at
            continue
        if bare[at] in "{};":
            begin = at + 1
        out.append(text[at])
        at += 1
    return "".join(out)


def without_private(text: str) -> str:
    """Text of a header without the private members of its classes, which stand last."""
    return re.sub(r"\n *private:\n.*?(?=\n\};)", "", text, flags=re.DOTALL)


def name_of(code: str) -> str:
    """Name that a declaration introduces."""
    bare = re.sub(r"//[^\n]*", "", code)
    for pattern in _NAME:
        if found := pattern.search(bare):
            return found[1]
    raise ValueError(f"a declaration without a name: {code!r}")


def _pieces(text: str) -> Iterator[tuple[str, str]]:
    """Comment and code of each declaration."""
    comment: list[str] = []
    code: list[str] = []
    depth = 0
    for line in text.splitlines():
        bare = line.split("//")[0].strip()
        if not code and line.startswith("///"):
            comment.append(line[3:].removeprefix(" "))
        elif not code and _SKIPPED.match(bare):
            comment = []
        else:
            code.append(line.rstrip())
            depth += bare.count("{") - bare.count("}")
            if depth == 0 and (bare.endswith(";") or (bare.startswith("#define") and not bare.endswith("\\"))):
                yield "\n".join(comment), "\n".join(code)
                comment, code = [], []


def read(path: Path) -> Header:
    """A header's comment and its documented declarations. ValueError: its text is not understood."""
    lines = path.read_text(encoding="utf-8").splitlines()
    top = [line for line in lines if not line.startswith("// SPDX")]
    n = next(k for k, line in enumerate(top) if not line.startswith("///"))
    text = re.sub(r"^extern \"C\" \{\n(?:#[^\n]*\n)*\}$", "", "\n".join(top[n:]), flags=re.MULTILINE)
    found = [Declaration(name_of(code), said, code) for said, code in _pieces(without_private(without_bodies(text)))]
    comment = "\n".join(line[3:].removeprefix(" ") for line in top[:n])
    return Header(path, comment, [one for one in found if "detail" not in one.code.split("(")[0]])


@dataclass(frozen=True)
class Member:
    """A member of a struct."""

    type: str
    comment: str


def members(path: Path) -> dict[str, dict[str, Member]]:
    """Members of a header's structs by type and name, such as {"ipe_decode_t": {"n_frames": Member(..)}}."""
    text = path.read_text(encoding="utf-8")
    found: dict[str, dict[str, Member]] = {}
    for struct in re.finditer(r"typedef struct[^{;]*\{(.*?)^\}\s*(\w+);", text, re.DOTALL | re.MULTILINE):
        own = found.setdefault(struct[2], {})
        for match in re.finditer(r"^ +([^\n/;]+);[ ]*((?:///<[^\n]*(?:\n +///<?[^\n]*)*)?)", struct[1], re.MULTILINE):
            said = " ".join(part.strip() for part in re.split(r"///<?", match[2]) if part.strip())
            for name in re.findall(r"(\w+)\s*(?:\[[^\]]*\]\s*)*(?=,|$)", match[1]):
                own[name] = Member(match[1].removeprefix("_Atomic ").split()[0], said)
    return found
