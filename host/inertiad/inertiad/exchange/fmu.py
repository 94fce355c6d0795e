# SPDX-License-Identifier: Apache-2.0
"""The feed-forward as an FMU (FMI 3.0, Model Exchange and Co-Simulation) with live parameters at its inputs.

Inputs are the wanted pose, rate and accelerations and theta; all may change at any time. Outputs are the wrench and the
tensions of the cables. The model is host/fmi/feed_forward.cpp; the robot goes with it as resources/robot.cfg.
"""

import io
import platform
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

from inertiad.base import installation
from inertiad.base.error import InputError
from inertiad.robot import configuration, description
from inertiad_lcm import robot_config_t

TOKEN: Final = "inertiad-feed-forward-1"  # noqa: S105  (no secret)
"""of the model, raised with every change of its variables; tools/fmu.mk builds it in"""
CRC_BYTES: Final = 4
"""that end robot.cfg"""
MODEL: Final = "inertiad_feed_forward"


@dataclass(frozen=True)
class _Variable:
    name: str
    size: int
    unit: str
    says: str
    start: tuple[float, ...] = ()
    """of an input; empty: an output"""


def _variables(n_cables: int) -> list[_Variable]:
    """In the order of their value references, from 1 on."""
    none, level = (0.0,) * 3, (1.0, 0.0, 0.0, 0.0)
    return [
        _Variable("p", 3, "m", "place of P, W", none),
        _Variable("q", 4, "1", "attitude, quaternion w x y z, P to W; any length but 0", level),
        _Variable("a", 3, "m/s2", "acceleration of P, W", none),
        _Variable("w", 3, "rad/s", "rate, P axes", none),
        _Variable("alpha", 3, "rad/s2", "angular acceleration, P axes", none),
        _Variable("theta", 10, "1", "m, h = m cog, J xx yy zz yz xz xy about P, P axes; kg, kg m, kg m2"),
        _Variable("wrench", 6, "1", "force and moment about P that the cables must give, P axes; N, N m"),
        _Variable("tension", n_cables, "N", "of each cable, within the limits of robot.toml"),
    ]


def _unit(name: str) -> str:
    base = {
        "m": 'm="1"',
        "m/s2": 'm="1" s="-2"',
        "rad/s": 'rad="1" s="-1"',
        "rad/s2": 'rad="1" s="-2"',
        "N": 'kg="1" m="1" s="-2"',
        "1": "",
    }[name]
    return f"    <Unit name={quoteattr(name)}><BaseUnit {base}/></Unit>"


def _element(reference: int, v: _Variable) -> str:
    start = f' start="{" ".join(f"{x!r}" for x in v.start)}"' if v.start else ""
    causality = "input" if v.start else "output"
    return (
        f'    <Float64 name="{v.name}" valueReference="{reference}" causality="{causality}" variability="continuous" '
        f"unit={quoteattr(v.unit)}{start} description={quoteattr(v.says)}>"
        f'<Dimension start="{v.size}"/></Float64>'
    )


def model_description(name: str, n_cables: int, theta: tuple[float, ...], place: tuple[float, ...]) -> str:
    """modelDescription.xml. name: of the robot; theta [10], place [3]: values at the start."""
    variables = _variables(n_cables)
    starts = {"theta": theta, "p": place}
    variables = [_Variable(v.name, v.size, v.unit, v.says, starts.get(v.name, v.start)) for v in variables]
    elements = [_element(reference, v) for reference, v in enumerate(variables, 1)]
    feasible = len(variables) + 1
    outputs = [reference for reference, v in enumerate(variables, 1) if not v.start] + [feasible]
    says = f"Feed-forward of {name}: wrench and tensions of a wanted motion, with live inertial parameters"
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="3.0" modelName={quoteattr(f"feed-forward of {name}")}',
        f'    instantiationToken="{TOKEN}" generationTool="inertiad" license="Apache-2.0"',
        f'    description={quoteattr(says)} variableNamingConvention="flat">',
        f'  <ModelExchange modelIdentifier="{MODEL}"/>',
        f'  <CoSimulation modelIdentifier="{MODEL}" canHandleVariableCommunicationStepSize="true"/>',
        "  <UnitDefinitions>",
        *(_unit(unit) for unit in dict.fromkeys(v.unit for v in variables)),
        "  </UnitDefinitions>",
        "  <ModelVariables>",
        '    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>',
        *elements,
        f'    <Boolean name="feasible" valueReference="{feasible}" causality="output" variability="discrete" '
        'description="tensions within the limits give the wrench"/>',
        "  </ModelVariables>",
        "  <ModelStructure>",
        *(f'    <Output valueReference="{reference}"/>' for reference in outputs),
        *(f'    <InitialUnknown valueReference="{reference}"/>' for reference in outputs),
        "  </ModelStructure>",
        "</fmiModelDescription>",
        "",
    ]
    return "\n".join(lines)


def write(robot_file: Path, output: Path) -> str:
    """Write the FMU of robot.toml; what it holds, as text. InputError: unusable robot, model not built."""
    robot = description.load(robot_file)
    compiled = configuration.compile_robot(robot, str(robot_file))
    if robot.n_cables < 6:
        raise InputError(f"{robot_file}: {robot.n_cables} cables: allowed: 6 or more, fewer cannot give every wrench")
    theta = tuple(robot_config_t.decode(compiled[:-CRC_BYTES]).prior_theta)
    anchors = [cable.anchor for cable in robot.cable]
    middle = [sum(anchor[k] for anchor in anchors) / len(anchors) for k in range(3)]
    place = (middle[0], middle[1], 0.5 * middle[2])
    library = installation.feed_forward_model()
    written = io.BytesIO()  # so that output is whole or not there, whatever goes wrong
    with zipfile.ZipFile(written, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", model_description(robot.name, robot.n_cables, theta, place))
        archive.writestr("resources/robot.cfg", compiled)
        archive.write(library, f"binaries/{platform.machine()}-linux/{MODEL}.so")
    output.write_bytes(written.getvalue())
    return f"{output}: FMI 3.0, Model Exchange and Co-Simulation, {robot.n_cables} tensions, {platform.machine()}-linux"
