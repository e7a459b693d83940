"""Build the C++ kernel while pip builds the package, by the compiler of the wheel `ziglang`.

`NEEDLEFIT_CXX` names a system compiler instead; what that builds does not promise the same bytes.
`NEEDLEFIT_TARGET` builds for another platform, one of `TARGETS`. All wheels are built on any platform by

    pip install hatchling ziglang==0.17.1 && python hatch_build.py dist
"""

import hashlib
import importlib.util
import json
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from packaging.tags import sys_tags

COMPILER = "ziglang==0.17.1"
FOLDER = Path("needlefit", "mechanics", "native")
INDEX = "libraries.json"
FLAGS = [
    "-std=c++20",
    "-O3",
    "-ffp-contract=off",
    "-fno-exceptions",
    "-fno-rtti",
    "-fno-threadsafe-statics",
    "-fvisibility=hidden",
    "-fno-math-errno",
    "-Wno-psabi",
    "-s",
]
"""Strict arithmetic: no contraction, so that all processors compute the same bytes."""

ZIG_FLAGS = ["-x", "c++", "-nostdinc++", "-fno-sanitize=undefined"]
SHARED = ["-shared", "-fPIC"]
WASM = (
    "-target wasm32-freestanding -mcpu=generic+simd128+bulk_memory -nostdlib -Wl,--no-entry,--export-dynamic"
)
X86_LEVELS = ("2", "3", "4")

TARGETS = {
    "x86_64-linux-gnu": ("x86_64-linux-gnu.2.17", "manylinux_2_17_x86_64.manylinux2014_x86_64", ".so"),
    "aarch64-linux-gnu": ("aarch64-linux-gnu.2.17", "manylinux_2_17_aarch64.manylinux2014_aarch64", ".so"),
    "x86_64-linux-musl": ("x86_64-linux-musl", "musllinux_1_2_x86_64", ".so"),
    "aarch64-linux-musl": ("aarch64-linux-musl", "musllinux_1_2_aarch64", ".so"),
    "x86_64-macos": ("x86_64-macos.11.0", "macosx_11_0_x86_64", ".dylib"),
    "aarch64-macos": ("aarch64-macos.11.0", "macosx_11_0_arm64", ".dylib"),
    "x86_64-windows": ("x86_64-windows-gnu", "win_amd64", ".dll"),
}
"""The compiler's target, the wheel's tag and the suffix of its libraries."""


def find_target() -> str:
    """Return the platform to build for: this one, unless another is asked for."""
    asked = os.environ.get("NEEDLEFIT_TARGET")
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(
        platform.machine().lower(), platform.machine().lower()
    )
    libc = "musl" if Path("/lib").is_dir() and list(Path("/lib").glob("ld-musl-*")) else "gnu"
    system = {"Linux": f"linux-{libc}", "Darwin": "macos", "Windows": "windows"}.get(platform.system(), "")
    target = asked or f"{machine}-{system}"
    if target not in TARGETS and not os.environ.get("NEEDLEFIT_CXX"):
        sys.exit(f"needlefit: {COMPILER} has no {target}; set NEEDLEFIT_CXX to a C++20 compiler")
    return target


def digest_sources(folder: Path) -> str:
    """Return the digest of the kernel's sources."""
    files = sorted(path for path in folder.iterdir() if path.suffix in (".hpp", ".cpp"))
    return hashlib.sha256(b"".join(path.name.encode() + path.read_bytes() for path in files)).hexdigest()


def describe_build(folder: Path) -> dict[str, str]:
    """Return what a library is made from; the same description gives the same library."""
    compiler, target = os.environ.get("NEEDLEFIT_CXX") or COMPILER, find_target()
    commands = list_commands(folder, target).values()
    flags = [flag for command in commands for flag in command if flag != sys.executable]
    return {
        "sources": digest_sources(folder),
        "target": target,
        "compiler": compiler,
        "flags": " ".join(dict.fromkeys(flags)),
    }


def is_built(folder: Path) -> bool:
    """Return whether the libraries of these sources, flags and target exist."""
    try:
        index = json.loads((folder / INDEX).read_text())
        files = {name: (folder / name).read_bytes() for name in index["files"]}
    except (OSError, ValueError, KeyError):
        return False
    whole = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()} == index["files"]
    return whole and index["made_from"] == describe_build(folder)


def list_commands(folder: Path, target: str) -> dict[str, list[str]]:
    """Return the libraries to be made and the compiler's arguments for each."""
    system_compiler = os.environ.get("NEEDLEFIT_CXX")
    if system_compiler:
        suffix = {"Darwin": ".dylib", "Windows": ".dll"}.get(platform.system(), ".so")
        return {f"kernel{suffix}": [*shlex.split(system_compiler), *FLAGS, *SHARED]}
    triple, _, suffix = TARGETS[target]
    zig = [sys.executable, "-m", "ziglang", "cc", *ZIG_FLAGS, *FLAGS]
    native = [*zig, "-target", triple, *(["-shared"] if "windows" in target else SHARED)]
    levels = X86_LEVELS if target.startswith("x86_64") else ()
    found = {f"kernel-v{level}{suffix}": [*native, f"-mcpu=x86_64_v{level}"] for level in levels}
    found = found or {f"kernel{suffix}": native}
    return found | {"kernel.wasm": [*zig, *WASM.split(), "-DNEEDLEFIT_LANES=4"]}


def build(folder: Path) -> None:
    """Build the libraries of a platform beside their sources; until all are built nothing changes."""
    if not os.environ.get("NEEDLEFIT_CXX") and importlib.util.find_spec("ziglang") is None:
        sys.exit(
            f"needlefit: install {COMPILER}, or set NEEDLEFIT_CXX to a C++20 compiler, to build the kernel"
        )
    made_from = describe_build(folder)
    with tempfile.TemporaryDirectory() as place:
        caches = {name: str(Path(place, "cache")) for name in ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR")}
        commands = list_commands(folder, made_from["target"])
        libraries = {name: Path(place, name) for name in commands}

        def compile_library(name: str) -> None:
            compiler = " ".join(commands[name][:4])
            try:
                made = subprocess.run(
                    [*commands[name], str(folder / "abi.cpp"), "-o", str(libraries[name])],
                    env=os.environ | caches, capture_output=True, text=True, check=False,
                )  # fmt: skip
            except OSError as error:
                sys.exit(f"needlefit: the compiler {compiler} could not be run: {error.strerror}")
            if made.returncode != 0:
                sys.exit(f"needlefit: the kernel could not be compiled by {compiler}\n{made.stderr}")

        with ThreadPoolExecutor(os.cpu_count()) as pool:  # each compiler uses one core
            list(pool.map(compile_library, commands))
        for old in folder.glob("kernel*"):
            old.unlink()
        for name, library in libraries.items():
            shutil.copy(library, folder / name)
    files = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in libraries}
    (folder / INDEX).write_text(json.dumps({"made_from": made_from, "files": files}, indent=2) + "\n")


class KernelHook(BuildHookInterface[Any]):
    """Hatchling's hook."""

    def dependencies(self) -> list[str]:
        """Ask for the compiler, where it is needed."""
        needed = not os.environ.get("NEEDLEFIT_CXX") and not is_built(Path(self.root) / FOLDER)
        return [COMPILER] if needed else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build what is missing, and put it into the wheel."""
        folder = Path(self.root) / FOLDER
        if not is_built(folder):
            build(folder)
        names = [INDEX, *json.loads((folder / INDEX).read_text())["files"]]
        build_data["artifacts"] += [f"/{(FOLDER / name).as_posix()}" for name in names]
        build_data["pure_python"] = False
        target, own = find_target(), os.environ.get("NEEDLEFIT_CXX")
        # what a system compiler has built is for systems like this one
        build_data["tag"] = f"py3-none-{next(sys_tags()).platform if own else TARGETS[target][1]}"


def build_wheels(out: str) -> None:
    """Build the wheels of all platforms; last that of this one, whose libraries stay beside the sources."""
    for target in sorted(TARGETS, key=lambda target: target == find_target()):
        command = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", out]
        subprocess.run(command, env=os.environ | {"NEEDLEFIT_TARGET": target}, check=True)


if __name__ == "__main__":
    build_wheels(*sys.argv[1:])
