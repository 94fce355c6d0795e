# SPDX-License-Identifier: Apache-2.0
"""Licences and parts of what is shipped: NOTICE as text, and a software bill of materials (CycloneDX 1.5)."""

import ctypes
import datetime
import json
import re
from collections.abc import Iterator
from email.message import Message
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

TOP = Path(__file__).resolve().parent.parent
LCM_SOURCE = "https://github.com/lcm-proj/lcm"
GLIB_SOURCE = "https://gitlab.gnome.org/GNOME/glib"
HEAD = """\
inertiad
Copyright The inertiad authors
Licensed under the Apache License, Version 2.0 (file LICENSE).

Parts of other projects in what is shipped
==========================================

liblcm (LGPL-2.1-or-later, {source})
  The daemon inertiad, libinertiad_lcm and the Python binding load liblcm.so.1 when they start; nothing shipped is
  linked with it statically. To use another build of liblcm, replace that file: in the system's library folder (.debs,
  which depend on the package liblcm1 of the distribution), in lib/ of site-packages (wheel; it is the one of the
  Python package lcm), in PREFIX/lib/inertiad/lib (make install). LD_LIBRARY_PATH serves, too. Inline functions of
  lcm_coretypes.h are compiled into the programs; their source and this project's are public, and `make` links them
  again. The Python package lcm, in inertiad-tools and below PREFIX/lib/inertiad, has liblcm in lcm/_lcm.so; its source
  is that of the same version at the address above. liblcm loads the system's libglib-2.0.so.0, which is not shipped:
  GLib, LGPL-2.1-or-later, {glib}.
"""
ROBIN = "nanobind/ext/robin_map/include/tsl"
UNSTATED = {"lcm": "LGPL-2.1-or-later"}
"""Licences of packages whose metadata has none; read in their licence files."""
COMPILED = (
    "Compiled into the Python binding inertiad_core and inertiad_replay, and used by the C++ headers:",
    "  Eigen (MPL-2.0, https://eigen.tuxfamily.org): its source, unchanged, is at that address",
    "  nanobind {nanobind} (BSD-3-Clause), robin-map {robin} (MIT): texts below",
    "Compiled into inertiad_feed_forward.so, the model of `inertiactl export --to fmu`:",
    "  Eigen, as above; lcm_coretypes.h, as above; header files of FMI {fmi} (BSD-2-Clause): text below",
)
BUNDLED = """\
Python packages in inertiad-tools.deb and below PREFIX/lib/inertiad of make install, each with its licence in its
.dist-info folder. The wheel holds none of them: pip installs them from their own wheels.
"""


class Part(NamedTuple):
    """Something that others wrote and that is shipped, or loaded."""

    name: str
    version: str
    licence: str
    place: str
    """package URL"""


def _licence(found: Message) -> str:
    """As the package states it: an SPDX expression, else its classifiers, else its own words."""
    if found["Name"] in UNSTATED:
        return UNSTATED[found["Name"]]
    if expression := found.get("License-Expression"):
        return str(expression)
    classifiers = [c.rpartition(" :: ")[2] for c in found.get_all("Classifier") or [] if c.startswith("License ::")]
    words = " ".join((found.get("License") or "").split())
    return "; ".join(classifiers) or (words if 0 < len(words) < 60 else "see its licence file")


def python_packages(folder: Path) -> list[Part]:
    """Of a folder that pip filled."""
    found = [d.metadata for d in metadata.distributions(path=[str(folder)]) if d.metadata["Name"] != "inertiad"]
    parts = [Part(m["Name"], m["Version"], _licence(m), f"pkg:pypi/{_key(m['Name'])}@{m['Version']}") for m in found]
    return sorted(parts, key=lambda part: part.name.lower())


def _key(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _robin_version() -> str:
    """Of the copy in nanobind."""
    header = metadata.distribution("nanobind").locate_file(f"{ROBIN}/robin_growth_policy.h")
    return ".".join(re.findall(r"#define TSL_RH_VERSION_(?:MAJOR|MINOR|PATCH) (\d+)", Path(str(header)).read_text()))


def _glib_version() -> str:
    """Of the system that builds."""
    library = ctypes.CDLL("libglib-2.0.so.0")
    parts = (ctypes.c_uint.in_dll(library, f"glib_{part}_version") for part in ("major", "minor", "micro"))
    return ".".join(str(part.value) for part in parts)


def _fmi_header() -> str:
    """Of the copy in fmpy."""
    return Path(str(metadata.distribution("fmpy").locate_file("fmpy/c-code/fmi3Functions.h"))).read_text()


def _fmi_version() -> str:
    return re.findall(r"declares the functions of FMI ([\d.]+\d)", _fmi_header())[0]


def compiled_in() -> list[Part]:
    """What the bindings and programs contain or load."""
    macros = Path("/usr/include/eigen3/Eigen/src/Core/util/Macros.h").read_text()
    eigen = ".".join(re.findall(r"#define EIGEN_(?:WORLD|MAJOR|MINOR)_VERSION (\d+)", macros))
    nanobind, lcm = metadata.version("nanobind"), metadata.version("lcm")
    robin, glib = _robin_version(), _glib_version()
    return [
        Part("eigen", eigen, "MPL-2.0", f"pkg:generic/eigen@{eigen}"),
        Part("nanobind", nanobind, "BSD-3-Clause", f"pkg:pypi/nanobind@{nanobind}"),
        Part("robin-map", robin, "MIT", f"pkg:github/Tessil/robin-map@v{robin}"),
        Part("fmi-headers", _fmi_version(), "BSD-2-Clause", f"pkg:generic/fmi-headers@{_fmi_version()}"),
        Part("liblcm", lcm, "LGPL-2.1-or-later", f"pkg:github/lcm-proj/lcm@v{lcm}"),
        Part("glib", glib, "LGPL-2.1-or-later", f"pkg:generic/glib@{glib}?download_url={GLIB_SOURCE}"),
    ]


def _texts() -> Iterator[tuple[str, str]]:
    """Licences that must accompany a binary."""
    nanobind = metadata.distribution("nanobind")
    for file in nanobind.files or []:
        if file.name == "LICENSE":
            yield "nanobind", file.locate().read_text()  # type: ignore[attr-defined]
    robin = Path(str(nanobind.locate_file(f"{ROBIN}/robin_map.h"))).read_text()
    comment = robin.split("*/", 1)[0].removeprefix("/**")
    yield "robin-map", "\n".join(line.removeprefix(" *").removeprefix(" ") for line in comment.strip().splitlines())
    fmi = _fmi_header()
    yield "header files of FMI", fmi[fmi.index("Copyright (C)") :].split("*/", 1)[0]


def text(dependencies: Path) -> str:
    """NOTICE. dependencies: a folder that pip filled with those of a base installation."""
    compiled = "\n".join(COMPILED).format(
        nanobind=metadata.version("nanobind"), robin=_robin_version(), fmi=_fmi_version()
    )
    parts = [HEAD.format(source=LCM_SOURCE, glib=GLIB_SOURCE), compiled, "", BUNDLED]
    parts += [f"  {p.name} {p.version}: {p.licence}" for p in python_packages(dependencies)]
    for name, licence in _texts():
        parts += ["", f"{name}", "-" * len(name), licence.strip()]
    return "\n".join(parts) + "\n"


def sbom(dependencies: Path, version: str, epoch: int) -> str:
    """CycloneDX 1.5 as JSON."""

    def component(part: Part) -> dict[str, Any]:
        licence = (
            {"expression": part.licence} if re.fullmatch(r"[\w.+-]+( (AND|OR|WITH) [\w.+-]+)*", part.licence) else None
        )
        return {
            "type": "library",
            "bom-ref": part.place,
            "name": part.name,
            "version": part.version,
            "purl": part.place,
            "licenses": [licence or {"license": {"name": part.licence}}],
        }

    own = f"pkg:generic/inertiad@{version}"
    parts = [*compiled_in(), *python_packages(dependencies)]
    document = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {
            "timestamp": datetime.datetime.fromtimestamp(epoch, datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            "component": {
                "type": "application",
                "bom-ref": own,
                "name": "inertiad",
                "version": version,
                "purl": own,
                "licenses": [{"license": {"id": "Apache-2.0"}}],
            },
        },
        "components": [component(part) for part in parts],
        "dependencies": [{"ref": own, "dependsOn": [part.place for part in parts]}],
    }
    return json.dumps(document, indent=2) + "\n"
