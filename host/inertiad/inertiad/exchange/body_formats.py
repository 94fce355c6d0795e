# SPDX-License-Identifier: Apache-2.0
"""An identified body as other programs read it.

All of them place the body in the platform frame P: CoG from P's origin, inertia about the CoG in axes parallel to P's,
as matrix entries, J_xy = -integral(x y dm). That is also what URDF's ixy and MuJoCo's fullinertia mean.

urdf  one link "platform", its frame is P         mjcf  a free body "platform", its frame is P
json  mass, cog, inertia_cog: as inertiactl simulate --body reads it
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

from inertiad.base import body as estimate
from inertiad.base.error import InputError
from inertiad.robot.keys import Nominal
from inertiad.robot.messages import validate

LINK: Final = "platform"
NOTE: Final = "SI; frame: platform P; inertia about the CoG, axes parallel to P, matrix entries"


def _text(values: list[float]) -> str:
    return " ".join(map(repr, values))


def _xml(root: ET.Element) -> str:
    root.insert(0, ET.Comment(f" {NOTE} "))
    ET.indent(root)
    return f'<?xml version="1.0"?>\n{ET.tostring(root, encoding="unicode")}\n'


def urdf(body: Nominal) -> str:
    """A robot of one link without shape."""
    root = ET.Element("robot", name=LINK)
    inertial = ET.SubElement(ET.SubElement(root, "link", name=LINK), "inertial")
    ET.SubElement(inertial, "origin", xyz=_text(body.cog), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(body.mass))
    xx, yy, zz, yz, xz, xy = map(repr, body.inertia_cog)
    ET.SubElement(inertial, "inertia", ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)
    return _xml(root)


def mjcf(body: Nominal) -> str:
    """A model of one free body without shape."""
    root = ET.Element("mujoco", model=LINK)
    ET.SubElement(root, "compiler", inertiafromgeom="false", balanceinertia="false")
    element = ET.SubElement(ET.SubElement(root, "worldbody"), "body", name=LINK)
    ET.SubElement(element, "freejoint")
    xx, yy, zz, yz, xz, xy = body.inertia_cog
    full = _text([xx, yy, zz, xy, xz, yz])
    ET.SubElement(element, "inertial", pos=_text(body.cog), mass=repr(body.mass), fullinertia=full)
    return _xml(root)


def as_json(body: Nominal) -> str:
    """The three keys of a true body."""
    return json.dumps(body.model_dump(), indent=1) + "\n"


FORMATS: Final[dict[str, Callable[[Nominal], str]]] = {"urdf": urdf, "mjcf": mjcf, "json": as_json}


def read(path: Path) -> Nominal:
    """The body of estimate.json, or of the one in a run folder. InputError: none there, or one that cannot exist."""
    file = path / "estimate.json" if path.is_dir() else path
    if not file.exists():
        raise InputError(f"{file}: not found; pass an estimate.json of the daemon or of inertiactl fit --json")
    if file.suffix != ".json":
        raise InputError(f"{file}: not an estimate; pass an estimate.json, or a run folder that has one")
    mass, *rest = estimate.read(file).value
    return validate(Nominal, {"mass": mass, "cog": rest[:3], "inertia_cog": rest[3:]}, str(file))


def write(path: Path, body: Nominal, form: str) -> None:
    """Write the body in one of FORMATS."""
    path.write_text(FORMATS[form](body), encoding="utf-8")
