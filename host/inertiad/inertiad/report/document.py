# SPDX-License-Identifier: Apache-2.0
"""The report of runs: its contents in order, and its files."""

from pathlib import Path

from inertiad.report import figures, page, printed, provenance, report_data, scene, tables, verdict, wording
from inertiad.report.page import Block, Fold, Page, Section, Tile
from inertiad.report.report_data import Facts, Progress


def _tiles(facts: Facts) -> list[Tile]:
    if facts.joint is None:
        return []
    value, std = facts.joint.body.value, facts.joint.body.std
    cog = [wording.number(1e3 * v, 1e3 * s) for v, s in zip(value[1:4], std[1:4], strict=True)]
    moments = [wording.number(v, s) for v, s in zip(value[4:7], std[4:7], strict=True)]
    sigma = [" / ".join(wording.number(k * s, k * s) for s in part) for k, part in ((1e3, std[1:4]), (1.0, std[4:7]))]
    return [
        Tile("mass", wording.number(value[0], std[0]), "kg", f"± {wording.number(std[0], std[0])} kg, one σ"),
        Tile("centre of gravity from P, x y z", " / ".join(cog), "mm", f"± {sigma[0]} mm"),
        Tile("moments of inertia about it, xx yy zz", " / ".join(moments), "kg m²", f"± {sigma[1]} kg m²"),
    ]


def _sections(facts: Facts) -> list[Section]:
    drawn: dict[str, list[Block]] = {name: [*found] for name, found in figures.all_of(facts).items()}
    sections = []
    if facts.joint is not None:
        solid = scene.scene(facts)
        blocks: list[Block] = [tables.result(facts), *([solid] if solid is not None else [])]
        sections.append(Section("result", "Result", blocks))
    if drawn["forces"]:
        sections.append(Section("forces", "Force sensors", [*drawn["forces"], Fold("Cables", tables.tensions(facts))]))
    if drawn["tensions"]:
        sections.append(Section("tensions", "Tensions", drawn["tensions"]))
    if drawn["convergence"]:
        sections.append(Section("convergence", "Convergence", drawn["convergence"]))
    if drawn["excitation"]:
        moved = [Fold("Greatest values", tables.motion(facts))] if facts.motions else []
        sections.append(Section("excitation", "Excitation", [*drawn["excitation"], *moved]))
    if drawn["observability"]:
        sections.append(Section("observability", "Observability", drawn["observability"]))
    if drawn["methods"]:
        refused = [f"{wording.METHOD_NAMES[m]}: {r}" for m, r in facts.methods.items() if isinstance(r, str)]
        found = {m: r for m, r in facts.methods.items() if not isinstance(r, str)}
        refused += [f"{wording.METHOD_NAMES[m]}: {note}" for m, r in found.items() for note in r.notes]
        sections.append(
            Section("methods", "Methods", [*drawn["methods"], *refused, Fold("Numbers", tables.methods(facts))])
        )
    if drawn["repeatability"]:
        sections.append(Section("repeatability", "Runs", drawn["repeatability"]))
    if drawn["calibration"]:
        errors = Fold("All sensor errors", tables.calibration(facts))
        sections.append(Section("calibration", "Calibration", [*drawn["calibration"], errors]))
    counters = tables.counters(facts)
    sections.append(
        Section(
            "timing",
            "Timing and loss",
            [tables.loss(facts), *drawn["timing"], *([Fold("All counters", counters)] if counters else [])],
        )
    )
    notes = [f"{run.name}: {note}" for run in facts.runs if run.recording is not None for note in run.recording.notes]
    origin: list[Block] = [provenance.origin(facts), *notes, Fold("Files", provenance.files(facts))]
    return [*sections, Section("provenance", "Provenance", origin)]


def page_of(facts: Facts) -> Page:
    """The whole report."""
    names = ", ".join(run.name for run in facts.runs)
    seconds = sum(run.recording.duration for run in facts.runs if run.recording is not None)
    subtitle = f"{names}: {seconds:.1f} s, {facts.robot.n_cables} cables"
    return Page(
        f"{facts.robot.name}: mass, centre of gravity, inertia",
        subtitle,
        verdict.judge(facts),
        _tiles(facts),
        _sections(facts),
    )


def write(
    paths: list[Path], robot_file: Path | None, output: Path, folder: Path | None, command: str, progress: Progress
) -> list[str]:
    """Write the page, and each drawing as PNG and PDF into a folder if one is given. Returns the verdict in lines.

    InputError: a path is not there, or has no robot description. The page names runs that cannot be used.
    """
    facts = report_data.gather(paths, robot_file, command, progress)
    progress("draw")
    made = page_of(facts)
    output.write_text(page.render(made), encoding="utf-8")
    if folder is not None:
        printed.write_all(page.drawings_of(made), folder)
    return verdict.summary(made.verdict)
