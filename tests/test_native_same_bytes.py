"""The same bytes of 2 000 random insertions, a quarter of them in space, on all processors.

The problems, with all features and given tables of laws, are written to a file. The kernel as an executable
(`native/driver.cpp`) computes them on an x86-64 processor without AVX and an aarch64 one, which QEMU emulates
(`qemu-user`), on Windows, of which Wine has what it calls, and on this one at each level that it has; Node.js
computes them in WebAssembly. What is not installed is skipped.
`pytest -m on_demand tests/test_native_same_bytes.py` runs it.
"""

import hashlib
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import mpmath
import numpy as np
import pytest
from mechanics_cases import (
    draw_shape,
    random_needle,
    random_rigidity,
    random_rules,
    random_steps,
    random_tissue,
)
from native_cases import read_numbers
from space_cases import leave_plane

from hatch_build import FLAGS, ZIG_FLAGS
from needlefit.mechanics import native
from needlefit.mechanics.batch import DERIVATIVE_KINDS, find_columns
from needlefit.mechanics.control import Bevel, ModelOptions
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.packing import INPUTS_ALONG_Z, pack_insertion, pack_problem

pytestmark = pytest.mark.on_demand
INSERTIONS, SPATIAL_EACH = 2000, 4
INPUTS = "d541d81a49b5cb6caeaa39dfe13a553d4b8b8c55"
#: SHA-1 of the problems and of the results
RESULTS = "6e8146df3434867e5898534e516fff0874106459"

HERE = Path(__file__).parent / "native"
EMULATED = {
    "x86-64-v2": ("x86_64-linux-musl", "x86_64_v2", ["qemu-x86_64", "-cpu", "Nehalem"]),
    "aarch64": ("aarch64-linux-musl", "generic", ["qemu-aarch64"]),
    "windows": ("x86_64-windows-gnu", "x86_64_v2", ["wine"]),
    "x86-64-v3": ("x86_64-linux-musl", "x86_64_v3", []),
    "x86-64-v4": ("x86_64-linux-musl", "x86_64_v4", []),
}


def make_table(stiffening):
    """Return a table of k = 1 / (1 - b d^2) with b = `stiffening` / 10, the same on every platform."""
    pieces, terms = native.TABLE_PIECES, native.TABLE_TERMS
    with mpmath.workprec(200):
        angles = [mpmath.pi * (2 * j + 1) / (2 * terms) for j in range(terms)]
        numbers = []
        for piece in range(pieces):
            d = [(piece + (1 + mpmath.cos(angle)) / 2) * mpmath.mpf(8) / 10 / pieces for angle in angles]
            k = [1 / (1 - mpmath.mpf(stiffening) / 10 * one**2) for one in d]
            for m in range(terms):
                total = sum(value * mpmath.cos(m * angle) for value, angle in zip(k, angles, strict=True))
                numbers.append(float(total * (1 if m == 0 else 2) / terms))
    table = np.array([native.TABLE_COMPRESSION - 1e-12, 0.0, *numbers])
    table[1] = native.measure_table_range(table)
    return table


def round_digits(values):
    """Return what is the same whichever library has computed the powers."""
    return np.array([float(f"{value:.9g}") for value in np.ravel(values)]).reshape(np.shape(values))


def make_problem(rng, tables, spatial):
    """Return an insertion with everything that the kernel knows, in the plane or in space."""
    rules = random_rules(rng)
    needle, tissue = random_needle(rng, rules), random_tissue(rng, rules, rng.choice([0.0, 0.0, 0.3]))
    needle = replace(needle, flexural_rigidity=float(round_digits(np.array(needle.flexural_rigidity))))
    steps = random_steps(rng, int(rng.integers(0, 5)))
    if rng.random() < 0.3:
        rules = ModelOptions(rules.spacing, rules.element, advance="path_angle")
        steps = tuple(replace(s, bevel=Bevel(0.0, s.bevel.side, s.bevel.offset / 8)) for s in steps)
    if spatial:
        steps = leave_plane(rng, steps, 90.0)  # whose sines are those of any library
    sets = int(rng.choice([1, 2, 5, 9]))
    mu = round_digits(10 ** rng.uniform(-5, 2, (sets, tissue.layers)))
    mu[rng.random(sets) < 0.02] = np.nan  # these fail, as do some of those in the softest tissue
    values = {
        "mu": mu,
        "shape": np.moveaxis(draw_shape(LAWS[tissue.law], rng, (sets, tissue.layers)), 0, 1),
        "rigidity": round_digits(random_rigidity(rng, rules, sets)),
        "base_y": rng.uniform(-0.5, 0.5, sets),
    }
    values["cut_angle" if rules.path_angle else "offset"] = rng.uniform(
        0, 0.3 / (8 if rules.path_angle else 1), sets
    )
    if all(len(step.controls.before) == 1 for step in steps):
        values["guide_x"] = rng.uniform(-30, -2, sets)
    kinds = (*DERIVATIVE_KINDS, *INPUTS_ALONG_Z) if spatial else DERIVATIVE_KINDS
    columns = find_columns(kinds, tissue, steps, rules)
    columns = columns if rng.random() < 0.3 else None
    lattice, packed = pack_insertion(steps, needle.length, rules)
    problem = pack_problem(
        needle, tissue, steps, lattice, rules, packed, sets=sets, values=values, columns=columns
    )
    if problem.terms == 0:
        arrays = dict(problem.arrays)
        for name in ("law", "law_by") if problem.columns else ("law",):
            shape = arrays[name].shape
            rows = [tables[rng.integers(len(tables))] for _ in range(arrays[name].size // shape[-1])]
            arrays[name] = np.array(rows).reshape(shape)
        problem = native.KernelProblem.make(read_numbers(problem), arrays)
    return problem


def list_problems(count):
    """Return problems, their numbers of constraint points and where positions are wanted."""
    tables = [make_table(stiffening) for stiffening in range(1, 7)]
    for seed in range(count):
        problem = make_problem(np.random.default_rng(seed), tables, seed % SPATIAL_EACH == SPATIAL_EACH - 1)
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
    shapes, lanes = native.make_shapes(problem, points), native.count_lanes()
    for array in shapes.arrays.values():
        array.fill(0)
    for first in range(0, problem.sets, lanes):
        native.simulate(problem, shapes, first, lanes)
    names = [name for name, _ in native.Shapes._fields_[2:]]
    found = b"".join(shapes.arrays[name].tobytes() for name in names if name in shapes.arrays)
    nodes = int(shapes.arrays["nodes"][0])
    x, u, slope = (np.ascontiguousarray(shapes.arrays[name][..., :nodes]) for name in ("x", "u", "slope"))
    return found + native.compute_positions(x, u, slope, s)[..., : 1 + len(u)].tobytes()


def digest(content):
    return hashlib.sha1(content).hexdigest()


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    """Return the file of the problems, and the SHA-1 of the results by the library of this process."""
    place, problems, results = (
        tmp_path_factory.mktemp("problems") / "problems",
        hashlib.sha1(),
        hashlib.sha1(),
    )
    with place.open("wb") as file:
        for problem, points, s in list_problems(INSERTIONS):
            content = write_problem(problem, points, s)
            file.write(content), problems.update(content)
            results.update(compute_results(problem, points, s))
    print(f"problems {problems.hexdigest()}, results {results.hexdigest()}")
    return place, results.hexdigest()


def test_the_problems_are_the_documented_ones(cases):
    assert digest(cases[0].read_bytes()) == INPUTS
    assert cases[1] == RESULTS


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
    compiler = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        *ZIG_FLAGS,
        *FLAGS,
        "-target",
        target,
        f"-mcpu={level}",
    ]
    subprocess.run([*compiler, "-static", str(HERE / "driver.cpp"), "-o", str(driver)], check=True)
    subprocess.run([*emulator, str(driver), str(cases[0]), str(results)], check=True)
    assert digest(results.read_bytes()) == cases[1]


def test_webassembly_gives_the_same_bytes(cases, tmp_path):
    if shutil.which("node") is None:
        pytest.skip("no Node.js")
    files = [native.FOLDER / "memory.js", native.FOLDER / "kernel.wasm", cases[0], tmp_path / "results"]
    subprocess.run(["node", str(HERE / "driver.mjs"), *map(str, files)], check=True)
    assert digest(files[-1].read_bytes()) == cases[1]


def test_every_library_of_the_package_gives_the_same_bytes(cases, tmp_path):
    """Each in a process of its own, since one is loaded once."""
    index = json.loads((native.FOLDER / "libraries.json").read_text())
    own = native.load_library().nf_processor_level()
    program = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "import hashlib, test_native_same_bytes as t\n"
        "found = hashlib.sha1()\n"
        "for one in t.list_problems(t.INSERTIONS): found.update(t.compute_results(*one))\n"
        "print(found.hexdigest())"
    )
    names = [name for name in index["files"] if name.startswith("kernel-v") and int(name[8]) <= own]
    for name in names:
        environment = {"NEEDLEFIT_LIBRARY": str(native.FOLDER / name), "PYTHONPATH": ":".join(sys.path)}
        words = [sys.executable, "-c", program, str(Path(__file__).parent)]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
        assert done.stdout.split()[-1] == cases[1], name
