# SPDX-License-Identifier: Apache-2.0
"""Debian packages of what make install puts below /usr.

inertiad          the daemon, its service, example robots
inertiad-tools    inertiactl with its Python packages, which no Debian release has in these versions
libinertiad0      the core and the messages as shared libraries
libinertiad-dev   headers, static libraries, pkg-config, CMake

All but inertiad-tools, whose Python packages are this machine's, also for architectures that make has cross-built.
"""

import datetime
import gzip
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

TOP = Path(__file__).resolve().parent.parent
RELEASE = TOP / "build/release"
MAINTAINER = "{} <{}>".format(
    os.environ.get("DEBFULLNAME", "The inertiad authors"), os.environ.get("DEBEMAIL", "inertiad@inertiad.invalid")
)
"""Debian wants an address: that of whoever builds, else one that reaches nobody."""
OVERRIDES = """\
# Not for upload to Debian: no bug to close, and without DEBEMAIL no address that reaches anybody.
NAME: bogus-mail-host *
NAME: bogus-mail-host-in-debian-changelog *
NAME: initial-upload-closes-no-bugs *
"""
POSTINST = """\
#!/bin/sh
set -e
if [ "$1" = configure ] && [ -z "$DPKG_ROOT" ] && [ -d /run/systemd/system ]; then
    systemd-tmpfiles --create inertiad.conf || true
    deb-systemd-invoke daemon-reload || true
    [ -z "$2" ] || deb-systemd-invoke try-restart inertiad.service || true
fi
"""
PRERM = """\
#!/bin/sh
set -e
if [ "$1" = remove ] && [ -z "$DPKG_ROOT" ] && [ -d /run/systemd/system ]; then
    deb-systemd-invoke stop inertiad.service || true
fi
"""
COMPILE = """\
#!/bin/sh
set -e
if [ "$1" = configure ]; then
    python3 -m compileall -q ${DPKG_ROOT:+-s "$DPKG_ROOT"} "$DPKG_ROOT/usr/lib/inertiad" || true
fi
"""
CLEAN = """\
#!/bin/sh
set -e
find "$DPKG_ROOT/usr/lib/inertiad" -name __pycache__ -type d -prune -exec rm -rf {} +
"""


class Package(NamedTuple):
    """One .deb."""

    name: str
    section: str
    summary: str
    text: str
    """lines of the description, each of at most 79 characters"""
    files: tuple[str, ...]
    """below /usr, as patterns"""
    depends: tuple[str, ...] = ()
    recommends: str = ""
    scripts: tuple[tuple[str, str], ...] = ()


class Machine(NamedTuple):
    """What packages are built for."""

    architecture: str
    """Debian's name"""
    sysroot: Path | None = None
    """of another machine than this one: what tools/sysroot fetched"""

    @property
    def parts(self) -> Path:
        """Where the packages' trees are made."""
        return RELEASE / "deb" / self.architecture

    def triplet(self, run: Callable[..., str]) -> str:
        """Its name among library folders."""
        return run("dpkg-architecture", f"-a{self.architecture}", "-qDEB_HOST_MULTIARCH").strip()


def packages(version: str, has_tools: bool) -> list[Package]:
    """All, or all but the host tools, in an order in which each pattern takes what is left."""
    minor = sys.version_info[1]
    same = f"(= {version})"
    tools = [
        Package(
            "inertiad-tools",
            "science",
            "host tools of inertiad, inertial parameters of cable robots",
            "inertiactl describes a robot, compiles the description for the daemon,\n"
            "simulates, records, replays and verifies runs, plans motions, fits and\n"
            "calibrates offline, and shows the running estimate. Its Python packages lie in\n"
            "/usr/lib/inertiad and concern no other program.",
            (
                "bin/inertiactl",
                "lib/inertiad",
                "share/man/man1",
                "share/man/man5",
                "share/bash-completion",
                "share/zsh",
                "share/fish",
            ),
            (f"python3 (>= 3.{minor})", f"python3 (<< 3.{minor + 1})"),
            f"inertiad {same}",
            (("postinst", COMPILE), ("prerm", CLEAN)),
        ),
    ]
    return [
        *(tools if has_tools else []),
        Package(
            "libinertiad-dev",
            "libdevel",
            "core of inertiad, development files",
            "Headers of the C core and of the C++ layer on Eigen, static libraries,\n"
            "pkg-config files, a CMake package, and the LCM message types.",
            (
                *("include", "share/inertiad/lcm_types", "lib/*/pkgconfig", "lib/*/cmake"),
                *("lib/*/libinertiad*.a", "lib/*/libinertiad*.so"),
            ),
            (f"libinertiad0 {same}",),
            "libeigen3-dev, liblcm-dev",
        ),
        Package(
            "libinertiad0",
            "libs",
            "core of inertiad, shared libraries",
            "The core: from CAN frames and tracker positions to mass, centre of gravity and\n"
            "inertia of a cable robot's platform, without heap, for C and C++ programs.",
            ("lib/*/libinertiad*.so.*",),
        ),
        Package(
            "inertiad",
            "science",
            "daemon that identifies a cable robot's platform from its CAN bus",
            "Reads IMU and cable forces from CAN (SocketCAN), positions of a tracker over\n"
            "LCM, and publishes mass, centre of gravity and inertia of the platform with\n"
            "calibrated uncertainty while it moves.",
            ("bin", "lib", "share"),
            (),
            f"inertiad-tools {same}" if has_tools else "",
            (("postinst", POSTINST), ("prerm", PRERM)),
        ),
    ]


def _install(root: Path, machine: Machine, run: Callable[..., str]) -> None:
    """Everything that was built for the machine, below root."""
    options = (f"DESTDIR={root}", "PREFIX=/usr", f"LIBDIR=/usr/lib/{machine.triplet(run)}", "KIND=system")
    if machine.sysroot is None:
        run("make", "-s", "install", *options, "BYTECODE=no", "SYSTEM_PYTHON=/usr/bin/python3")
    else:
        built = (f"B=build/{machine.architecture}", f"MAN={RELEASE}/man")
        run("make", "-s", "install-daemon", "install-library", *options, *built)


def _take(patterns: tuple[str, ...], usr: Path, root: Path) -> None:
    """Move what matches into the package's own tree."""
    for pattern in patterns:
        for path in sorted(usr.glob(pattern)):
            target = root / "usr" / path.relative_to(usr)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.move(path, target)
            for parent in path.parents:  # folders that are empty now
                if parent == usr or any(parent.iterdir()):
                    break
                parent.rmdir()


def _documents(root: Path, name: str, version: str, epoch: int) -> None:
    """Copyright, changelog and reasons for what lintian would have in another way."""
    folder = root / "usr/share/doc" / name
    folder.mkdir(parents=True, exist_ok=True)
    for file in ("LICENSE", "changelog.md"):
        (folder / file).unlink(missing_ok=True)
    shutil.copy(TOP / "firmware/packaging/debian/copyright", folder)
    notice = (RELEASE / "stage/NOTICE").read_bytes()
    (folder / "NOTICE.gz").write_bytes(gzip.compress(notice, 9, mtime=0))
    when = datetime.datetime.fromtimestamp(epoch, datetime.UTC).strftime("%a, %d %b %Y %H:%M:%S +0000")
    entry = f"{name} ({version}) unstable; urgency=medium\n\n  * See changelog.gz.\n\n -- {MAINTAINER}  {when}\n"
    (folder / "changelog.Debian.gz").write_bytes(gzip.compress(entry.encode(), 9, mtime=0))
    (folder / "changelog.gz").write_bytes(gzip.compress((TOP / "CHANGELOG.md").read_bytes(), 9, mtime=0))
    own = TOP / "firmware/packaging/debian" / f"{name}.lintian-overrides"
    target = root / "usr/share/lintian/overrides" / name
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(OVERRIDES.replace("NAME", name) + (own.read_text() if own.exists() else ""))


def _libraries(root: Path, name: str, machine: Machine) -> list[str]:
    """Packages whose libraries the programs load, by dpkg-shlibdeps; those of bundled Python packages need no newer.

    Libraries of another architecture are found below debian/ of its sysroot, as those of packages that are being built.
    """
    own = [p for p in sorted(root.rglob("*")) if p.is_file() and not p.is_symlink() and _is_own_elf(p)]
    if not own:
        return []
    work = machine.sysroot or RELEASE / "shlibdeps"
    (work / "debian").mkdir(parents=True, exist_ok=True)
    (work / "debian/control").write_text(f"Source: inertiad\n\nPackage: {name}\nArchitecture: any\n")
    (work / "debian/shlibs.local").write_text("libinertiad 0 libinertiad0\nlibinertiad_lcm 0 libinertiad0\n")
    command = ["dpkg-shlibdeps", "-O", "--ignore-missing-info", f"-x{name}", *map(str, own)]
    host = {**os.environ, "DEB_HOST_ARCH": machine.architecture}
    done = subprocess.run(command, cwd=work, env=host, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"dpkg-shlibdeps: {name}: {done.stderr}")
    return done.stdout.strip().removeprefix("shlibs:Depends=").split(", ")


def _is_own_elf(path: Path) -> bool:
    if "usr/lib/inertiad/" in str(path) and not path.name.startswith(("inertiad_", "_lcm")):
        return False
    with path.open("rb") as file:
        return file.read(4) == b"\x7fELF"


def _control(package: Package, root: Path, version: str, machine: Machine) -> None:
    folder = root / "DEBIAN"
    folder.mkdir()
    size = sum(p.lstat().st_size for p in root.rglob("*") if p.is_file()) // 1024
    depends = ", ".join([*package.depends, *_libraries(root, package.name, machine)])
    lines = [
        f"Package: {package.name}",
        f"Version: {version}",
        f"Architecture: {machine.architecture}",
        f"Maintainer: {MAINTAINER}",
        f"Installed-Size: {size}",
        *([f"Depends: {depends}"] if depends else []),
        *([f"Recommends: {package.recommends}"] if package.recommends else []),
        f"Section: {package.section}",
        "Priority: optional",
        f"Description: {package.summary}",
        *(f" {line}" for line in package.text.splitlines()),
    ]
    (folder / "control").write_text("\n".join(lines) + "\n")
    for name, script in package.scripts:
        (folder / name).write_text(script)
        (folder / name).chmod(0o755)
    if package.name == "libinertiad0":
        (folder / "triggers").write_text("activate-noawait ldconfig\n")
        (folder / "shlibs").write_text(
            f"libinertiad 0 libinertiad0 (>= {version})\nlibinertiad_lcm 0 libinertiad0 (>= {version})\n"
        )
    files = sorted(p for p in (root / "usr").rglob("*") if p.is_file() and not p.is_symlink())
    sums = subprocess.run(
        ["md5sum", *(str(p.relative_to(root)) for p in files)], cwd=root, capture_output=True, check=True
    )
    (folder / "md5sums").write_bytes(sums.stdout)


def _build_for(machine: Machine, out: Path, version: str, epoch: int, run: Callable[..., str]) -> None:
    """All packages for one machine into out."""
    whole = machine.parts / "all"
    _install(whole, machine, run)
    for package in packages(version, has_tools=machine.sysroot is None):
        root = machine.parts / package.name
        _take(package.files, whole / "usr", root)
        _documents(root, package.name, version, epoch)
        _control(package, root, version, machine)
        path = out / f"{package.name}_{version}_{machine.architecture}.deb"
        for part in root.rglob("*"):
            os.utime(part, (epoch, epoch), follow_symlinks=False)
        run("dpkg-deb", "--root-owner-group", "-Zxz", "-z1", "--threads-max=1", "--build", root, path)
    left = [p for p in whole.rglob("*") if p.is_file()]
    if left:
        sys.exit(f"dist: in no package: {', '.join(str(p.relative_to(whole)) for p in left)}")


def build(out: Path, version: str, epoch: int, run: Callable[..., str], foreign: Sequence[str] = ()) -> None:
    """All packages into out, for this machine and for the foreign architectures that make has built."""
    shutil.rmtree(RELEASE / "deb", ignore_errors=True)
    machines = [Machine(run("dpkg", "--print-architecture").strip())]
    machines += [Machine(name, TOP / "build" / name / "sysroot") for name in foreign]
    for machine in machines:
        _build_for(machine, out, f"{version}-1", epoch, run)
