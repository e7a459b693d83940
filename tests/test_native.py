"""The native kernel beneath the model: its functions, its bytes, and what it does with wrong arrays."""

import ctypes
import shutil
import subprocess

import mpmath
import numpy as np
import pytest
from native_cases import compute, make_problem, read_numbers, to_bytes
from numpy.random import default_rng

from needlefit import Bevel, Controls, ModelOptions, Needle, Step, Tissue
from needlefit.mechanics import native
from needlefit.mechanics.packing import pack_insertion, pack_problem

NEEDLE = Needle.from_tube(150.0, 1.27, 80e3)
TISSUE = Tissue(mu=[0.2, 33.0], alpha=[1.0, -1.0], boundaries=[9.3])
CANONICAL_NAN = 0x7FF8000000000000


# ---- elementary functions


def evaluate(which, x):
    found = np.empty_like(x)
    native.load_library().nf_function(
        ctypes.c_int64(which), ctypes.c_int64(len(x)), native._at(x), native._at(found)
    )
    return found


def spread(low, high, count=4000):
    return default_rng(0).uniform(low, high, count)


def near(at):
    """Return numbers on both sides of a place, to the last digit."""
    away = 10 ** default_rng(1).uniform(-15, -1, 500)
    return np.concatenate((at + away, at - away))


@pytest.mark.parametrize(
    ("which", "exact", "x", "ulp"),
    [
        (0, mpmath.exp, np.concatenate((spread(-708, 709.7), spread(-2, 2), near(0.0))), 1.0),
        (1, mpmath.log, np.concatenate((10 ** spread(-300, 300), spread(0.5, 2), near(1.0))), 1.0),
        (2, lambda x: mpmath.log1p(-x), np.concatenate((spread(0, 0.99), near(0.0), near(0.25))), 2.5),
        (3, mpmath.sin, np.concatenate((spread(-1, 1), spread(-100, 100), near(0.0), near(np.pi))), 1.5),
        (4, mpmath.cos, np.concatenate((spread(-1, 1), spread(-100, 100), near(0.0), near(np.pi / 2))), 1.5),
    ],
)
def test_functions_are_exact_to_units_in_the_last_place(which, exact, x, ulp):
    found = evaluate(which, x)
    with mpmath.workprec(200):
        true = [exact(mpmath.mpf(value)) for value in x.tolist()]
        errors = [
            abs(mpmath.mpf(value) - expected) / float(np.spacing(abs(float(expected))))
            for value, expected in zip(found.tolist(), true, strict=True)
        ]
    assert max(errors) < ulp


# ---- the same bytes


def test_failed_sets_have_canonical_nans():
    steps = (Step(14.0, Bevel(0.1), Controls(base_y=0.3)),)
    lattice, packed = pack_insertion(steps, NEEDLE.length, ModelOptions())
    mu = np.full((8, 2), 0.2)
    mu[1], mu[3], mu[5], mu[6] = np.nan, -np.nan, np.inf, -1.0
    problem = pack_problem(NEEDLE, TISSUE, steps, lattice, ModelOptions(), packed, sets=8, values={"mu": mu})
    arrays = compute(problem)
    assert set(np.flatnonzero(arrays["status"])) >= {1, 3, 5}
    assert np.isnan(arrays["u"][0, 1, : int(arrays["nodes"][0])]).all()
    floats = [array for array in arrays.values() if array.dtype == np.float64]
    found = [array[np.isnan(array)].view(np.uint64) for array in floats]
    assert set(np.concatenate(found).tolist()) == {CANONICAL_NAN}


STATE = """
extern "C" {
#if defined(__x86_64__)
unsigned long read_state() { return __builtin_ia32_stmxcsr(); }
void write_state(unsigned long state) { __builtin_ia32_ldmxcsr(state); }
unsigned long foreign_state() { return 0x1f80 | 0x8040 | 0x4000; }  // subnormals are 0, rounding up
#elif defined(__aarch64__)
unsigned long read_state() { unsigned long state; asm volatile("mrs %0, fpcr" : "=r"(state)); return state; }
void write_state(unsigned long state) { asm volatile("msr fpcr, %0" : : "r"(state)); }
unsigned long foreign_state() { return 1ul << 24 | 1ul << 22; }
#endif
}
"""


@pytest.fixture(scope="module")
def in_foreign_state(tmp_path_factory):
    """Return what calls a function in a state of the arithmetic unit that another library has left behind."""
    if shutil.which("g++") is None:
        pytest.skip("no g++ to set the state with")
    source, library = (tmp_path_factory.mktemp("state") / name for name in ("state.cpp", "state.so"))
    source.write_text(STATE)
    subprocess.run(["g++", "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
    state = ctypes.CDLL(str(library))
    state.read_state.restype = state.foreign_state.restype = ctypes.c_ulong
    foreign = state.foreign_state()

    def call(function):
        before = state.read_state()
        state.write_state(ctypes.c_ulong(foreign))
        try:
            function()
        finally:
            after = state.read_state()
            state.write_state(ctypes.c_ulong(before))
        assert after & foreign == foreign

    return call


@pytest.mark.parametrize("seed", [0, 1])
def test_the_bytes_do_not_depend_on_the_state_of_the_arithmetic_unit(seed, in_foreign_state):
    problem = make_problem(default_rng(seed))
    expected, found = to_bytes(compute(problem)), {}
    in_foreign_state(lambda: found.update(to_bytes(compute(problem))))
    assert found == expected


# ---- wrong arrays

COUNTS = [-1, 0, 1, 2, 3, 9, 1000, 2**24, 2**31, 2**40, 2**63 - 1, -(2**63)]
NUMBERS = [np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0, 1e-320, 1e-9, 0.3, 0.5, 1.0, 7.0, 1e9, 1e300]


def damage(rng, numbers, arrays):
    """Change one thing of a problem."""

    def change(value, values):
        return rng.choice(values) if rng.random() < 0.6 else value + rng.integers(-2, 3)

    if rng.random() < 0.3:
        name = str(rng.choice(sorted(numbers)))
        kind, values = (int, COUNTS) if name in native._SIZES else (float, NUMBERS)
        numbers[name] = kind(change(numbers[name], values))
        return
    name = str(rng.choice(sorted(arrays)))
    array = arrays[name].copy()
    kind = rng.random()
    if kind < 0.2:
        del arrays[name]
    elif kind < 0.5:
        other = np.zeros(array.shape, "f4")
        wrong = [array[:-1], np.tile(array, 2), array[..., None], array[::-1], other, np.zeros(0)]
        arrays[name] = wrong[rng.integers(len(wrong))]
    elif array.size:
        field = array[str(rng.choice(array.dtype.names))] if array.dtype.names else array
        at = tuple(rng.integers(field.shape))
        field[at] = change(field[at], NUMBERS if field.dtype == np.float64 else COUNTS)
        arrays[name] = array


def use(rng, problem):
    """Call the kernel with whatever has been accepted."""
    compute(problem, int(rng.choice([1, native.count_lanes()])))
    if problem.sets == 1:
        session = native.SessionMemory(problem)
        for depth in rng.choice([*NUMBERS, *rng.uniform(0.0, problem.deepest, 4)], 6):
            try:
                session.advance(problem, float(depth), int(rng.integers(2)), int(rng.integers(2)))
            except (TypeError, native.RayRoomError):
                continue
            session.accept()


def run_fuzz(seed):
    """Return whether a damaged problem was accepted; what is not must be a TypeError."""
    rng = default_rng(seed)
    problem = make_problem(rng)
    numbers, arrays = read_numbers(problem), dict(problem.arrays)
    for _ in range(rng.integers(1, 4)):
        damage(rng, numbers, arrays)
    arrays["stops"] = arrays.get("stops", problem.arrays["stops"]).copy()
    limits = {"max_iterations": 1000, "deepest": 1e4, "rays": 1e4, "columns": 1e3, "guides": 1e3}
    if any(numbers[name] > limit for name, limit in limits.items()) or numbers["element"] < 1e-3:
        numbers["stop_count"] = 0  # would only take long, or fill the memory
    try:
        use(rng, native.KernelProblem.make(numbers, arrays))
    except TypeError:
        return False
    return True


@pytest.mark.parametrize("part", range(3))
def test_damaged_problems_are_errors(part):
    accepted = [run_fuzz(seed) for seed in range(100 * part, 100 * part + 100)]
    assert 10 < sum(accepted) < 90
