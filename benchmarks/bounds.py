"""The largest inputs that are accepted: how long they take and how much memory, each in a process of its own.

    python benchmarks/bounds.py [--json] [NAME ...]

Times are of the processor, all threads together; memory is the most that the process held, the program
itself (about 200 MB) included. No input may take a minute or 2 GB.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import cycle, islice

import numpy as np

from needlefit.mechanics.batch import Batch, linearize_steps, simulate_batches
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import count_element_solves
from needlefit.mechanics.scene import Scene, iterate_states, simulate_scene
from needlefit.mechanics.session import Session
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.limits import (
    MAX_BATCH_ELEMENT_SOLVES,
    MAX_ELEMENT_SOLVES,
    MAX_ELEMENTS,
    MAX_GUIDES,
    MAX_ITERATIONS,
    MAX_LAYERS,
    MAX_NEEDLE_LENGTH_MM,
    MAX_STEPS,
    MIN_ELEMENT_MM,
)

STEEL = 1.0216e4  # N mm^2, 18 gauge
LONG = Needle(MAX_NEEDLE_LENGTH_MM, STEEL)
DEEP = MAX_NEEDLE_LENGTH_MM - 1.0
SOFT = Tissue(np.array([0.05]), np.array([1.0]))
FINE = ModelOptions(MIN_ELEMENT_MM, MIN_ELEMENT_MM)
FINE_DEPTH = MAX_ELEMENTS * MIN_ELEMENT_MM
COSTLY = ModelOptions(tolerance=1e-13, max_iterations=MAX_ITERATIONS)


def tissue(layers: int = 4, depth: float = DEEP, friction: float = 0.0) -> Tissue:
    """Return soft and stiff layers in turns."""
    mu = np.array(list(islice(cycle((0.2, 33.0)), layers)))
    tops = np.linspace(0, depth, layers + 1)[1:-1]
    return Tissue(mu, np.ones(layers), tops, friction=np.full(layers, friction))


def there_and_back(depth: float, rules: ModelOptions, most: int = MAX_STEPS) -> tuple[Step, ...]:
    """Return as many insertions and retractions as one insertion may have."""
    steps, side = [Step(depth, Bevel(1e-4))], cycle((1, -1))
    while len(steps) < most:
        more = [*steps, Step(1.0, Bevel(1e-4)), Step(depth, Bevel(1e-4, next(side)))]
        if (
            count_element_solves(tuple(step.depth for step in more), rules.spacing, rules.element)
            > MAX_ELEMENT_SOLVES
        ):
            break
        steps = more
    return tuple(steps)


def moved(depth: float) -> tuple[Step, ...]:
    """Return an insertion whose base moves, again and again, as often as is allowed."""
    cost = 2 * depth + 4
    count = int(min(MAX_STEPS - 1, (MAX_ELEMENT_SOLVES - count_element_solves((depth,), 1.0, 1.0)) / cost))
    steps = [Step(depth, Bevel(1e-3))]
    return tuple(steps + [Step(depth, Bevel(1e-3), Controls(base_y=0.01 * (n % 7))) for n in range(count)])


def guided(within: bool) -> tuple[Step, ...]:
    """Return an insertion through as many guides as there may be."""
    places = np.linspace(10, 0.9 * DEEP, MAX_GUIDES) if within else -np.linspace(0.01, 0.5, MAX_GUIDES)
    guides = tuple(Guide(float(x), slope=None, in_tissue=within) for x in places)
    return (Step(DEEP, Bevel(0.0), Controls(guides=guides)),)


def of(needle: Needle, layers: Tissue, steps: tuple[Step, ...], rules: ModelOptions) -> Callable[[], object]:
    """Return what inserts a needle once."""
    return lambda: simulate_steps(needle, layers, steps, rules)


def seen(steps: tuple[Step, ...], rules: ModelOptions) -> Callable[[], object]:
    """Return what inserts a needle as `simulate` does, every step kept."""
    return lambda: simulate_scene(Scene(LONG, tissue(), steps, rules))


def in_batch(layers: Tissue) -> Callable[[], object]:
    """Return what solves the largest batch of the deepest insertion."""
    sets = int(MAX_BATCH_ELEMENT_SOLVES / count_element_solves((DEEP,), 1.0, 1.0))
    offset = np.linspace(1e-4, 1e-3, sets)
    return lambda: simulate_batches([Batch(LONG, layers, (Step(DEEP, Bevel(1e-3)),), offset=offset)])


def by_hand() -> object:
    """Insert the deepest needle in steps of half a cell, then move its base."""
    session = Session(LONG, tissue(), Bevel(1e-3), rules=ModelOptions())
    while session.depth < DEEP - 1:
        session.step(insert=0.5)
    return [session.step(base=(0.01 * n, 0.0)) for n in range(200)]


CASES: dict[str, Callable[[], object]] = {
    "deepest": of(LONG, tissue(), (Step(DEEP, Bevel(1e-3)),), ModelOptions()),
    "deepest, bent": of(LONG, tissue(), (Step(DEEP, Bevel(0.05)),), ModelOptions()),
    "deepest, tolerance 1e-13, 200 iterations": of(LONG, tissue(), (Step(DEEP, Bevel(0.03)),), COSTLY),
    "deepest, very soft": of(
        LONG, Tissue(np.array([1e-5]), np.array([1.0])), (Step(DEEP, Bevel(1e-5)),), ModelOptions()
    ),
    "finest": of(
        Needle(FINE_DEPTH + 50, STEEL), tissue(depth=FINE_DEPTH), (Step(FINE_DEPTH, Bevel(1e-3)),), FINE
    ),
    "most layers": of(LONG, tissue(MAX_LAYERS), (Step(DEEP, Bevel(1e-3)),), ModelOptions()),
    "friction": of(LONG, tissue(friction=0.5), (Step(DEEP, Bevel(1e-3)),), ModelOptions()),
    "most guides": of(LONG, tissue(), guided(False), ModelOptions()),
    "most guides in the tissue": of(LONG, tissue(), guided(True), ModelOptions()),
    "in and out of 100 mm": seen(there_and_back(100.0, ModelOptions()), ModelOptions()),
    "in and out of 1000 mm": seen(there_and_back(1000.0, ModelOptions()), ModelOptions()),
    "base moved, 3000 mm deep": seen(moved(3000.0), ModelOptions()),
    "base moved, 100 mm deep": seen(moved(100.0), ModelOptions()),
    "on its way": lambda: sum(
        1
        for _ in iterate_states(
            Scene(LONG, SOFT, there_and_back(2000.0, ModelOptions(5.0, 1.0)), ModelOptions(5.0, 1.0))
        )
    ),
    "by hand": by_hand,
    "batch": in_batch(tissue()),
    "batch with friction": in_batch(tissue(friction=0.5)),
    "derivatives": lambda: linearize_steps(LONG, tissue(), (Step(DEEP, Bevel(1e-3)),)),
    "derivatives, most layers": lambda: linearize_steps(LONG, tissue(MAX_LAYERS), (Step(DEEP, Bevel(1e-3)),)),
}


def alone(name: str) -> dict[str, object]:
    """Return what one case takes in this process."""
    begin, wall = time.process_time(), time.perf_counter()
    found = CASES[name]()
    last = found[-1] if isinstance(found, (list, tuple)) and found else found
    return {
        "seconds": round(time.process_time() - begin, 2),
        "wall": round(time.perf_counter() - wall, 2),
        "MB": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3),
        "status": getattr(last, "status", ""),
        "iterations": int(np.max(getattr(last, "iterations", 0))),
    }


def measured(names: list[str]) -> Iterator[tuple[str, dict[str, object]]]:
    """Yield each case's figures, from a process of its own."""
    for name in names:
        command = [sys.executable, __file__, "--alone", name]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        yield name, json.loads(done.stdout)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="Some cases; by default all.")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.alone:
        print(json.dumps({key: str(value) if key == "status" else value
                          for key, value in alone(arguments.names[0]).items()}))  # fmt: skip
        return
    figures = {}
    for name, values in measured(arguments.names or list(CASES)):
        figures[name] = values
        if not arguments.json:
            print(f"{name:42s}" + "".join(f"  {key} {value}" for key, value in values.items()), flush=True)
    if arguments.json:
        print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    main()
