"""One needle: a step of a session, an insertion in one call, and its Jacobian.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/steps.py [--rounds N] [--beside-python PYTHON]

The insertion of `reference_problem`, tolerance 1e-7 mm. Times are processor time of the thread, everything
around the kernel included.
"""

from collections.abc import Callable

import numpy as np
from in_turns import make_parser, measure, print_table, time_call
from reference_problem import BEVEL, DEPTH, NEEDLE, TISSUE

from needlefit.mechanics.batch import linearize
from needlefit.mechanics.control import ModelOptions
from needlefit.mechanics.session import Session
from needlefit.mechanics.simulate import simulate

FINE = ModelOptions(tolerance=1e-9)


def insert(step: float) -> Callable[[], object]:
    """Return a whole session in steps of so many mm; its beginning counts."""

    def call() -> None:
        session = Session(NEEDLE, TISSUE, BEVEL)
        for _ in range(round(DEPTH / step)):
            session.step(step)

    return call


def move_base() -> Callable[[], object]:
    """Return moves of the base at the whole depth; none comes twice."""
    session = Session(NEEDLE, TISSUE, BEVEL)
    session.step(DEPTH)
    rng = np.random.default_rng(2)

    def call() -> None:
        for y, slope in rng.normal(size=(50, 2)) * (1.0, 0.005):
            session.step(base=(y, slope))

    return call


def list_cases() -> dict[str, Callable[[], float]]:
    """Return the cases; each gives microseconds per step."""

    def time_steps(call: Callable[[], object], steps: float = DEPTH) -> Callable[[], float]:
        return lambda: 1e6 * time_call(call) / steps

    return {
        "Session, steps of 1 mm": time_steps(insert(1.0)),
        "Session, steps of 0.1 mm": time_steps(insert(0.1), 10 * DEPTH),
        "Session, steps of 5 mm": time_steps(insert(5.0), DEPTH / 5),
        "Session, base moved at 55 mm": time_steps(move_base(), 50),
        "simulate": time_steps(lambda: simulate(NEEDLE, TISSUE, BEVEL, DEPTH)),
        "simulate, 1e-9 mm": time_steps(lambda: simulate(NEEDLE, TISSUE, BEVEL, DEPTH, rules=FINE)),
        "linearize, 1e-9 mm": time_steps(lambda: linearize(NEEDLE, TISSUE, BEVEL, DEPTH, rules=FINE)),
    }


def main() -> None:
    """Print the figures."""
    options = make_parser(__doc__.splitlines()[0], rounds=20).parse_args()
    print_table(measure(list_cases, options), "us per step")


if __name__ == "__main__":
    main()
