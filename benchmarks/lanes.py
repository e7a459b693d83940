"""Many parameter sets side by side: time per step and set, of shapes and of derivatives, and their errors.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/lanes.py [--rounds N] [--beside-python PYTHON]
    ... --errors      largest errors against full passes to 1e-11 mm

The insertion of `reference_problem`, 512 sets within 30 % of nominal or over broad priors. One thread is
timed by its processor time, two by the clock. `one full pass a step` linearises all elements once at every
stop, as derivatives must: a guide in the tissue, which the tip does not reach, keeps the kernel from its
quick scheme. Derivatives are those by mu and alpha of four layers and the bevel's offset, to 1e-9 mm, without
the tip's track. A bevel that is rolled by 90 degrees at 25 mm takes the needle to space; turned over there,
it stays in the plane.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from inspect import signature

import numpy as np
from in_turns import HERE, make_parser, measure, print_table, time_call
from reference_problem import BEVEL, DEPTH, batch

from needlefit.mechanics.batch import Batch, linearize_batches, simulate_batches
from needlefit.mechanics.control import Controls, Guide, ModelOptions, Step

UNTRACKED = {"tracked": False} if "tracked" in signature(linearize_batches).parameters else {}
"""Empty of an earlier commit."""

SETS, ERROR_SETS = 512, 10_000
TOLERANCE_MM = 1e-7
TURN_MM = 25.0
TURNED, ROLLED = "turned over, 1 thread", "rolled by 90 degrees, 1 thread"
FULL_PASS, JACOBIAN = "one full pass a step, 1 thread", "Jacobian of nine parameters, 1 thread"
TURNED_JACOBIAN, ROLLED_JACOBIAN = f"Jacobian, {TURNED}", f"Jacobian, {ROLLED}"


def spread_over_priors(sets: Batch) -> Batch:
    """Return as many sets over broad priors."""
    rng, count = np.random.default_rng(5), len(sets)
    return replace(
        sets,
        mu=10 ** rng.uniform(np.log10(0.05), np.log10(60), (count, 4)),
        shape=rng.uniform(-3, 3, (count, 1, 4)),
        offset=rng.uniform(0, 0.2, count),
    )


def take_full_passes(sets: Batch) -> Batch:
    """Return the same insertion, with mostly one pass at each stop, in which all elements are linearised."""
    guide = Guide(DEPTH + 10.0, 0.0, None, in_tissue=True)
    step = Step(DEPTH, BEVEL, Controls(guides=(guide,)))
    return replace(sets, steps=(step,), rules=replace(sets.rules, tolerance=1e-3))


def turn_bevel(sets: Batch, roll_deg: float) -> Batch:
    """Return the same insertion with the bevel turned on the way: by half a turn, or out of the plane."""
    try:
        turned = replace(BEVEL, roll_deg=roll_deg)
    except TypeError:  # of an earlier commit: in the plane
        turned = replace(BEVEL, side=-1)
    return replace(sets, steps=(Step(TURN_MM, BEVEL), Step(DEPTH, turned)))


def list_cases() -> dict[str, Callable[[], float]]:
    """Return the cases; each gives microseconds per step and set."""
    nominal = batch(SETS, TOLERANCE_MM)
    priors = spread_over_priors(nominal)
    fine = batch(SETS, 1e-9)

    def time_sets(sets: Batch, threads: int) -> Callable[[], float]:
        clock = time.process_time if threads == 1 else time.perf_counter
        return lambda: 1e6 * time_call(lambda: simulate_batches([sets], threads), clock) / len(sets) / DEPTH

    def time_jacobians(given: Batch) -> float:
        def call() -> None:
            linearize_batches([given], ("mu", "shape", "offset"), 1, **UNTRACKED)

        return 1e6 * time_call(call) / len(given) / DEPTH

    return {
        "nominal, 1 thread": time_sets(nominal, 1),
        "nominal, 2 threads": time_sets(nominal, 2),
        "priors, 1 thread": time_sets(priors, 1),
        "priors, 2 threads": time_sets(priors, 2),
        FULL_PASS: time_sets(take_full_passes(nominal), 1),
        JACOBIAN: lambda: time_jacobians(fine),
        TURNED: time_sets(turn_bevel(nominal, 180.0), 1),
        ROLLED: time_sets(turn_bevel(nominal, 90.0), 1),
        TURNED_JACOBIAN: lambda: time_jacobians(turn_bevel(fine, 180.0)),
        ROLLED_JACOBIAN: lambda: time_jacobians(turn_bevel(fine, 90.0)),
    }


def print_errors() -> None:
    """Print the largest errors of shapes, mm, of nominal sets and over broad priors."""
    many = batch(ERROR_SETS, TOLERANCE_MM)
    priors = spread_over_priors(many)
    rolled = {
        f"{name}, rolled": turn_bevel(sets, 90.0) for name, sets in (("nominal", many), ("priors", priors))
    }
    for name, sets in ({"nominal": many, "priors": priors} | rolled).items():
        (found,) = simulate_batches([sets])
        (exact,) = simulate_batches([replace(sets, rules=ModelOptions(tolerance=1e-11))])
        errors = np.abs(found.u - exact.u).max(axis=1)[found.converged & exact.converged]
        print(
            f"{name}: {len(errors)} of {len(sets)} sets, largest {errors.max():.2g}, "
            f"99 % below {np.quantile(errors, 0.99):.2g} mm"
        )


def main() -> None:
    """Print the figures."""
    parser = make_parser(__doc__.splitlines()[0], rounds=20)
    parser.add_argument("--errors", action="store_true")
    options = parser.parse_args()
    if options.errors:
        print_errors()
    else:
        found = measure(list_cases, options)
        print_table(found, "us per step and set")
        for one, other in ((JACOBIAN, FULL_PASS), (ROLLED, TURNED), (ROLLED_JACOBIAN, TURNED_JACOBIAN)):
            print(f"{one}, times {other}: {np.median(found[one][HERE] / found[other][HERE]):.2f}")


if __name__ == "__main__":
    main()
