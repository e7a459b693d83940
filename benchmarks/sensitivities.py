"""Cost of the whole Jacobian beside a forward run, and beside central differences, at the same tolerance.

One insertion of 55 steps (150 mm needle, four layers, 1 mm elements and constraint points, Newton to
1e-9 mm), nine parameters: mu and alpha of each layer, and the bevel offset. Each round runs a few of each in
turns; ratios are taken within rounds, so that a machine busy with other work stretches both; medians of the
rounds are printed.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/sensitivities.py [--json] [--rounds N]

Times are processor time of the thread, everything around the kernel included. The last lines say how far
both derivatives of the tip's deflection agree, in fractions of each.
"""

import argparse
import dataclasses
import json
import time
from collections.abc import Callable

import numpy as np
from reference_problem import BEVEL, DEPTH, NEEDLE, TISSUE

from needlefit.mechanics.batch import linearize
from needlefit.mechanics.control import Bevel, ModelOptions
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue

RULES = ModelOptions(tolerance=1e-9)


def forward(tissue: Tissue = TISSUE, bevel: Bevel = BEVEL) -> float:
    """Return the deflection u of the tip, mm."""
    return float(simulate(NEEDLE, tissue, bevel, DEPTH, rules=RULES).u[-1])


def central_differences() -> np.ndarray:
    """Return the tip's derivatives (9,) from 18 forward runs."""
    slopes = []
    for kind, least in (("mu", 0.0), ("alpha", 1.0)):
        for i in range(TISSUE.layers):
            step = 1e-4 * max(abs(getattr(TISSUE, kind)[i]), least)
            change = step * (np.arange(TISSUE.layers) == i)
            either = [
                forward(dataclasses.replace(TISSUE, **{kind: getattr(TISSUE, kind) + sign * change}))
                for sign in (1, -1)
            ]
            slopes.append((either[0] - either[1]) / (2 * step))
    step = 1e-4 * BEVEL.offset
    either = [forward(bevel=Bevel(BEVEL.offset + sign * step)) for sign in (1, -1)]
    return np.array([*slopes, (either[0] - either[1]) / (2 * step)])


def measure(rounds: int) -> dict[str, float]:
    """Return microseconds per step of each way, and their ratios to the forward run."""
    ways: dict[str, tuple[int, Callable[[], object]]] = {
        "forward": (10, forward),
        "jacobian": (10, lambda: linearize(NEEDLE, TISSUE, BEVEL, DEPTH, rules=RULES)),
        "differences": (1, central_differences),
    }
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for _, call in ways.values():
        call()
    for _ in range(rounds):
        for name, (repeats, call) in ways.items():
            begin = time.thread_time()
            for _ in range(repeats):
                call()
            seconds[name].append((time.thread_time() - begin) / repeats)
    taken = {name: np.array(values) / DEPTH * 1e6 for name, values in seconds.items()}
    figures = {f"{name}_us_per_step": float(np.median(values)) for name, values in taken.items()}
    figures["derivatives_us_per_step"] = float(np.median(taken["jacobian"] - taken["forward"]))
    for name in ("jacobian", "differences"):
        figures[f"{name}_over_forward"] = float(np.median(taken[name] / taken["forward"]))
    shape, jacobian = linearize(NEEDLE, TISSUE, BEVEL, DEPTH, rules=RULES)
    figures["newton_iterations_per_step"] = shape.iterations / DEPTH
    differ = np.abs(central_differences() / jacobian.u[-1] - 1)
    figures["differences_differ_mu_offset"] = float(np.max(np.delete(differ, slice(4, 8))))
    figures["differences_differ_alpha"] = float(np.max(differ[4:8]))
    return figures


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--rounds", type=int, default=200)
    arguments = parser.parse_args()
    figures = measure(arguments.rounds)
    if arguments.json:
        print(json.dumps(figures, indent=2))
        return
    for name, value in figures.items():
        print(f"{name:30s} {value:12.4g}")


if __name__ == "__main__":
    main()
