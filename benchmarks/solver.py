"""The forward model one needle at a time, in sessions and in lanes: microseconds per step (and set).

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/solver.py [--rounds N] [--beside-python PYTHON]

The insertion of `reference_problem`, tolerance 1e-7 mm. One thread is timed by its processor time, two by the
clock; everything around the kernel is included. `lanes, 47 depths` are as many insertions as the paper's, 32
sets each. The last line is the largest difference between the tips of lanes and those of single needles.
"""

import time
from collections.abc import Callable, Sequence

import numpy as np
from in_turns import make_parser, measure, print_table, time_call
from reference_problem import BEVEL, DEPTH, NEEDLE, TISSUE, batch

from needlefit.mechanics.batch import Batch, linearize, simulate_batches
from needlefit.mechanics.control import ModelOptions
from needlefit.mechanics.session import Session
from needlefit.mechanics.simulate import simulate

TOLERANCE_MM = 1e-7
FINE = ModelOptions(tolerance=1e-9)
SETS = (32, 256, 1024)
RAGGED_MM = np.linspace(32.0, 78.0, 47).round()


def insert(step: float) -> Callable[[], object]:
    """Return a whole session in steps of so many mm; its beginning counts."""

    def call() -> None:
        session = Session(NEEDLE, TISSUE, BEVEL)
        for _ in range(round(DEPTH / step)):
            session.step(step)

    return call


def move_base() -> Callable[[], object]:
    """Return 50 moves of the base at the whole depth; none comes twice."""
    session = Session(NEEDLE, TISSUE, BEVEL)
    session.step(DEPTH)
    rng = np.random.default_rng(2)

    def call() -> None:
        for y, slope in rng.normal(size=(50, 2)) * (1.0, 0.005):
            session.step(base=(y, slope))

    return call


def list_cases() -> dict[str, Callable[[], float]]:
    """Return the cases; each gives microseconds per step (and set)."""

    def time_steps(call: Callable[[], object], steps: float = DEPTH) -> Callable[[], float]:
        return lambda: 1e6 * time_call(call) / steps

    def time_lanes(sets: Sequence[Batch], threads: int) -> Callable[[], float]:
        clock = time.process_time if threads == 1 else time.perf_counter
        steps = sum(step.depth * len(some) for some in sets for step in some.steps)
        return lambda: 1e6 * time_call(lambda: simulate_batches(sets, threads), clock) / steps

    ragged = [batch(32, TOLERANCE_MM, float(depth)) for depth in RAGGED_MM]
    return {
        "simulate": time_steps(lambda: simulate(NEEDLE, TISSUE, BEVEL, DEPTH)),
        "simulate, 1e-9 mm": time_steps(lambda: simulate(NEEDLE, TISSUE, BEVEL, DEPTH, rules=FINE)),
        "linearize, 1e-9 mm": time_steps(lambda: linearize(NEEDLE, TISSUE, BEVEL, DEPTH, rules=FINE)),
        "Session, steps of 1 mm": time_steps(insert(1.0)),
        "Session, steps of 0.1 mm": time_steps(insert(0.1), 10 * DEPTH),
        "Session, base moved at 55 mm": time_steps(move_base(), 50),
        **{
            f"lanes, {count} sets, {threads} thread{'s' * (threads > 1)}": time_lanes(
                [batch(count, TOLERANCE_MM)], threads
            )
            for count in SETS
            for threads in (1, 2)
        },
        "lanes, 47 depths, 1 thread": time_lanes(ragged, 1),
        "lanes, 47 depths, 2 threads": time_lanes(ragged, 2),
    }


def find_difference() -> float:
    """Return the largest difference between tips in lanes and those of single needles, mm."""
    sets = batch(SETS[0], TOLERANCE_MM)
    (shapes,) = simulate_batches([sets])
    alone = simulate_batches([sets.take(slice(i, i + 1)) for i in range(len(sets))])
    tips = np.array([one.u[0, -1] for one in alone])
    return float(np.abs(shapes.u[:, -1] - tips).max())


def main() -> None:
    """Print the figures."""
    options = make_parser(__doc__.splitlines()[0], rounds=8).parse_args()
    print_table(measure(list_cases, options), "us per step (and set)")
    print(f"largest difference of a tip in lanes from that of a single needle: {find_difference():.1g} mm")


if __name__ == "__main__":
    main()
