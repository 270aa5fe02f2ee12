"""Build the Debian package: `python3 packaging/build_deb.py --out out/deb` (`make deb`).

Its release is a virtual environment at `/opt/ltm/releases/VERSION` for Debian's Python, with the packages of
`requirements.lock`, whose SHA-256 are checked here, and their bytecode. The installation downloads and compiles
nothing: the package contains numba's kernels for two levels of x86-64 (`precompile.py`).
"""

import argparse
import compileall
import hashlib
import os
import py_compile
import shutil
import subprocess
import sys
import time
import tomllib
from importlib import metadata
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGING = REPOSITORY / "packaging"
RELEASES = "opt/ltm/releases"
PLACES = {
    "systemd/ltm.service": "usr/lib/systemd/system/ltm.service",
    "systemd/journald-ltm.conf": "usr/lib/systemd/journald@ltm.conf.d/ltm.conf",
    "systemd/sysusers-ltm.conf": "usr/lib/sysusers.d/ltm.conf",
    "systemd/tmpfiles-ltm.conf": "usr/lib/tmpfiles.d/ltm.conf",
    "systemd/release-guard": "usr/lib/ltm/release-guard",
    "debian/site.yaml": "etc/ltm/site.yaml",
    "debian/environment": "etc/ltm/environment",
}
CONFFILES = ("etc/ltm/site.yaml", "etc/ltm/environment")
"""Files that the administrator may change after the installation."""
DOCUMENTS = ("start", "site", "cameras", "deployment", "recordings", "region", "ros")
UNUSED = ("numba/tests", "numpy/*/tests", "scipy/*/tests", "scipy/*/*/tests", "llvmlite/tests", "rclpy/test")
"""Tests of other packages, a sixth of all bytes."""


def run(*command: str | Path, **environment: str) -> None:
    subprocess.run([str(part) for part in command], check=True, env=os.environ | environment)


def version_of_checkout() -> str:
    """Return the project's version with the number of commits, so that dpkg sorts later commits as later versions."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]

    def git(*arguments: str) -> str:
        ran = subprocess.run(["git", *arguments], cwd=REPOSITORY, capture_output=True, text=True, check=True)
        return ran.stdout.strip()

    version = f"{project}+{git('rev-list', '--count', 'HEAD')}.{git('rev-parse', '--short', 'HEAD')}"
    return version + (".changed" if git("status", "--porcelain", "--untracked-files=no") else "")


def checked_wheels(pip: list[str], folder: Path) -> list[Path]:
    """Return the wheels of all packages in the lock; downloads must have their stated hash. Source archives are built.
    The wheels are kept for later builds."""
    lock = PACKAGING / "requirements.lock"
    wheels = folder / hashlib.sha256(lock.read_bytes()).hexdigest()[:16]
    if not wheels.exists():
        partial = folder / "partial"
        shutil.rmtree(partial, ignore_errors=True)
        command = [*pip, "wheel", "--quiet", "--require-hashes", "--no-deps", "--requirement", str(lock)]
        run(*command, "--wheel-dir", partial)
        partial.rename(wheels)
    return sorted(wheels.glob("*.whl"))


def own_wheel(pip: list[str], folder: Path) -> Path:
    """Return the wheel of the checkout with compiled kernels, built from a copy without its folder `build`."""
    source = folder / "source"
    shutil.rmtree(source, ignore_errors=True)
    source.mkdir(parents=True)
    tracked = subprocess.run(["git", "ls-files", "-z"], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    for name in filter(None, tracked.stdout.split("\0")):
        if name.startswith(("tests/", "bags/", "docs/")) or not (REPOSITORY / name).exists():
            continue
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(REPOSITORY / name, source / name, follow_symlinks=False)
    run(sys.executable, PACKAGING / "precompile.py", source)
    for wheel in folder.glob("ltm-*.whl"):
        wheel.unlink()
    run(*pip, "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", folder, source)
    (wheel,) = folder.glob("ltm-*.whl")
    return wheel


def make_release(root: Path, version: str, python: str, pip: list[str], wheels: list[Path]) -> Path:
    """Make the virtual environment as it is after installation; no file contains the path of the build."""
    release = root / RELEASES / version
    run(python, "-I", "-m", "venv", "--without-pip", "--symlinks", release)
    command = [*pip, "--python", str(release / "bin/python"), "install", "--quiet", "--no-index", "--no-deps"]
    run(*command, "--no-compile", "--ignore-installed", *wheels)
    (release / "pyvenv.cfg").write_text(f"home = {Path(python).parent}\ninclude-system-site-packages = false\n")
    here, there = str(release), f"/{RELEASES}/{version}"
    for script in (release / "bin").iterdir():
        if script.name.lower().startswith("activate"):
            script.unlink()
        elif script.is_file() and not script.is_symlink():
            script.write_bytes(script.read_bytes().replace(here.encode(), there.encode()))
    (site_packages,) = release.glob("lib/python3.*/site-packages")
    for pattern in UNUSED:
        for folder in site_packages.glob(pattern):
            shutil.rmtree(folder)
    shutil.rmtree(release / "include", ignore_errors=True)
    link_equal_libraries(release / "lib")
    for record in site_packages.glob("*.dist-info/direct_url.json"):
        record.unlink()  # names the folder of the build
    documents = release / "share/doc/ltm"
    documents.mkdir(parents=True)
    for name in DOCUMENTS:
        shutil.copy(REPOSITORY / f"docs/{name}.md", documents)
    # By content, not by time: the files keep theirs through dpkg, but a copy might not.
    compileall.compile_dir(
        str(release / "lib"),
        quiet=2,
        stripdir=str(root),
        prependdir="/",
        invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH,
    )
    return release


def link_equal_libraries(folder: Path) -> None:
    """Replace equal libraries by links: ROS wheels contain each three times, as `libx.so`, `.so.2` and `.so.2.14.5`."""
    by_content: dict[bytes, Path] = {}
    # The longest name first: the others become links to it.
    for library in sorted(folder.glob("*.so*"), key=lambda path: (-len(path.name), path.name)):
        first = by_content.setdefault(hashlib.sha256(library.read_bytes()).digest(), library)
        if first is not library and first.name.startswith(library.name):
            library.unlink()
            library.symlink_to(first.name)


def add_control(root: Path, version: str, python: tuple[int, int]) -> None:
    size = sum(path.lstat().st_size for path in root.rglob("*") if path.is_file() and not path.is_symlink())
    control = root / "DEBIAN"
    control.mkdir()
    words = {
        "@VERSION@": version,
        "@SIZE@": str(size // 1024),
        "@PYTHON@": f"{python[0]}.{python[1]}",
        "@PYTHON_NEXT@": f"{python[0]}.{python[1] + 1}",
    }
    for name in ("control.in", "preinst", "postinst", "prerm", "postrm"):
        text = (PACKAGING / "debian" / name).read_text(encoding="utf-8")
        for word, value in words.items():
            text = text.replace(word, value)
        file = control / name.removesuffix(".in")
        file.write_text(text, encoding="utf-8")
        file.chmod(0o644 if name == "control.in" else 0o755)
    (control / "conffiles").write_text("".join(f"/{name}\n" for name in CONFFILES))
    sums = []
    for path in sorted(root.rglob("*")):
        name = str(path.relative_to(root))
        if path.is_file() and not path.is_symlink() and not name.startswith("DEBIAN/") and name not in CONFFILES:
            sums.append(f"{hashlib.md5(path.read_bytes(), usedforsecurity=False).hexdigest()}  {name}\n")
    (control / "md5sums").write_text("".join(sums))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="Folder for the package and the wheels.")
    parser.add_argument("--version", default="", help="Version; default: that of the checkout.")
    parser.add_argument("--python", default="/usr/bin/python3", help="Python of the towers (Debian).")
    parser.add_argument("--wheel", action="store_true", help="Build only the wheel.")
    options = parser.parse_args()
    pip, out = [sys.executable, "-m", "pip"], options.out.resolve()
    if options.wheel:
        print(own_wheel(pip, out))
        return
    begun = time.monotonic()
    version = options.version or version_of_checkout()
    asked = subprocess.run(
        [options.python, "-I", "-c", "import sys; print(*sys.version_info[:2])"],
        capture_output=True,
        text=True,
        check=True,
    )
    python = (int(asked.stdout.split()[0]), int(asked.stdout.split()[1]))
    if python != sys.version_info[:2]:
        raise SystemExit(f"{options.python} is Python {python}; run this program with the same version")
    if f"numba=={metadata.version('numba')} " not in (PACKAGING / "requirements.lock").read_text(encoding="utf-8"):
        raise SystemExit(
            f"requirements.lock has no numba {metadata.version('numba')}, which compiles the kernels here; "
            "install constraints.txt, or run make lock"
        )
    root = out / "root"
    shutil.rmtree(root, ignore_errors=True)
    os.umask(0o022)
    out.mkdir(parents=True, exist_ok=True)
    make_release(
        root, version, options.python, pip, [*checked_wheels(pip, out / "wheels"), own_wheel(pip, out / "own")]
    )
    for source, target in PLACES.items():
        (root / target).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(PACKAGING / source, root / target)
        (root / target).chmod(0o755 if (root / target).read_bytes().startswith(b"#!") else 0o644)
    (root / "etc/ltm/credentials").mkdir(mode=0o700)
    (root / "usr/bin").mkdir(parents=True)
    (root / "usr/bin/ltm").symlink_to("/opt/ltm/current/bin/ltm")
    add_control(root, version, python)
    package = out / f"ltm_{version}_amd64.deb"
    run("dpkg-deb", "--root-owner-group", "-Zzstd", "-z9", "--build", root, package)
    unpacked = sum(path.lstat().st_size for path in root.rglob("*") if path.is_file())
    shutil.rmtree(root)
    size, took = package.stat().st_size, time.monotonic() - begun
    print(f"{package}: {size / 1e6:.0f} MB, {unpacked / 1e6:.0f} MB installed, built in {took:.0f} s")


if __name__ == "__main__":
    main()
