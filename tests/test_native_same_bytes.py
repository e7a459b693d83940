"""The same bytes of 2 000 random insertions, a quarter of them in space, on all processors.

The problems are written to a file. The kernel as an executable
(`native/driver.cpp`) computes them on an x86-64 processor without AVX and an aarch64 one, which QEMU emulates
(`qemu-user`), on Windows, of which Wine has what it calls, and on this one at each level that it has; Node.js
computes them in WebAssembly. What is not installed is skipped.
`pytest -m on_demand tests/test_native_same_bytes.py` runs it.
"""

import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from native_cases import compute, make_problem

from hatch_build import FLAGS, ZIG_FLAGS
from needlefit.mechanics import native

pytestmark = pytest.mark.on_demand
INSERTIONS = 2000
HERE = Path(__file__).parent / "native"
EMULATED = {
    "x86-64-v2": ("x86_64-linux-musl", "x86_64_v2", ["qemu-x86_64", "-cpu", "Nehalem"]),
    "aarch64": ("aarch64-linux-musl", "generic", ["qemu-aarch64"]),
    "windows": ("x86_64-windows-gnu", "x86_64_v2", ["wine"]),
    "x86-64-v3": ("x86_64-linux-musl", "x86_64_v3", []),
    "x86-64-v4": ("x86_64-linux-musl", "x86_64_v4", []),
}


def list_problems(count):
    """Return problems, their numbers of constraint points and where positions are wanted."""
    for seed in range(count):
        problem = make_problem(np.random.default_rng(seed))
        last = problem.arrays["stops"][problem.stop_count - 1]
        s = float(last["tip"]) - problem.length * np.array([0.99, 0.5, 0.1, 0.05, 0.0])
        yield problem, int(last["cell"]) + 1, s


def write_problem(problem, points, s):
    """Return what the drivers read: 64-bit numbers, and each array behind the number of its bytes."""
    head = [points, *(getattr(problem, name) for name in native._SIZES)]
    parts = [np.array(head, np.int64).tobytes()]
    parts.append(np.array([getattr(problem, name) for name in native._NUMBERS]).tobytes())
    for content in [*(problem.arrays.get(name) for name in native._ARRAYS), s]:
        data = b"" if content is None else content.tobytes()
        parts += [np.int64(-1 if content is None else len(data)).tobytes(), data]
    return b"".join(parts)


def compute_results(problem, points, s):
    """Return the bytes that the drivers write, by the library of this process."""
    arrays = compute(problem)
    names = [name for name, _ in native.Shapes._fields_[2:]]
    found = b"".join(arrays[name].tobytes() for name in names if name in arrays)
    nodes = int(arrays["nodes"][0])
    x, u, slope = (np.ascontiguousarray(arrays[name][..., :nodes]) for name in ("x", "u", "slope"))
    return found + native.compute_positions(x, u, slope, s)[..., : 1 + len(u)].tobytes()


def digest(content):
    return hashlib.sha1(content).hexdigest()


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    """Return the file of the problems, and the SHA-1 of the results by the library of this process."""
    place, results = tmp_path_factory.mktemp("problems") / "problems", hashlib.sha1()
    with place.open("wb") as file:
        for one in list_problems(INSERTIONS):
            file.write(write_problem(*one))
            results.update(compute_results(*one))
    return place, results.hexdigest()


@pytest.mark.parametrize("processor", EMULATED)
def test_each_processor_gives_the_same_bytes(processor, cases, tmp_path):
    pytest.importorskip("ziglang")
    target, level, emulator = EMULATED[processor]
    if emulator and shutil.which(emulator[0]) is None:
        pytest.skip(f"no {emulator[0]}")
    own = native.load_library().nf_processor_level()
    if processor.startswith("x86") and not emulator and own < int(processor[-1]):
        pytest.skip(f"this processor has level {own}")
    driver, results = tmp_path / "driver.exe", tmp_path / "results"  # Wine runs no other name
    flags = [*ZIG_FLAGS, *FLAGS, "-target", target, f"-mcpu={level}", "-static"]
    words = [sys.executable, "-m", "ziglang", "cc", *flags, str(HERE / "driver.cpp"), "-o", str(driver)]
    subprocess.run(words, check=True)
    subprocess.run([*emulator, str(driver), str(cases[0]), str(results)], check=True)
    assert digest(results.read_bytes()) == cases[1]


def test_webassembly_gives_the_same_bytes(cases, tmp_path):
    if shutil.which("node") is None:
        pytest.skip("no Node.js")
    files = [native.FOLDER / "memory.js", native.FOLDER / "kernel.wasm", cases[0], tmp_path / "results"]
    subprocess.run(["node", str(HERE / "driver.mjs"), *map(str, files)], check=True)
    assert digest(files[-1].read_bytes()) == cases[1]
