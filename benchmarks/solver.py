"""The forward model, every way there is to run it: time per step, ratios, and proof that all find the same.

One insertion (150 mm needle of 18G solid, EI 10 216 N mm^2; 55 steps of 1 mm, four layers), nominal or with
sets within 30 % of nominal (`reference_problem`). All ways have the same quadrature and the same rule for
stopping Newton: a pass leaves at most its increment squared times the law's curvature, and no more passes
are made once that is below the tolerance. At 1e-7 mm that is what stopping at an increment of 1e-4 mm
leaves; 1e-9 mm is shown too.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/solver.py [--json] [--rounds N]

Each round runs all ways in turns, in one process. Ways with one thread are timed by the processor time of
that thread (median of the rounds). Ways with two need the clock on the wall, which other programs stretch:
they are called once at a time, after a rest, several times a round; the least and the median of all calls
are shown, and the processor time of both threads together. Ratios take the first column. `jax` is timed
where it is installed; needlefit does not need it.
"""

import argparse
import functools
import importlib.util
import json
import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from full_needle import FullNeedle
from numpy.typing import NDArray
from reference_problem import BEVEL, DEPTH, NEEDLE, TISSUE, batch

from needlefit.mechanics.batch import Batch, simulate_batches
from needlefit.mechanics.control import Bevel, ModelOptions, Step
from needlefit.mechanics.session import Session
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue

Floats = NDArray[np.float64]
TOLERANCES = (1e-7, 1e-9)  # mm
STEPS = round(DEPTH)
POOL = 2  # processes
LEAST = 0.02  # s, of a measurement on one thread
BURSTS, PAUSE = 8, 0.02  # calls in a round on several threads, and the rest before each, s
SETS = (32, 64, 256, 1024)
RAGGED = np.linspace(32.0, 78.0, 47).round()  # mm; as many insertions as the paper's, 55 mm deep on average
COMPARED = 4  # sets on which all ways have to agree
GOALS = {
    "lanes, us per step and lane": "<= 0.55",
    "lanes over solveh_banded": "about 1000",
    "lanes over scalar kernel": "10-15",
    "insertions per second": ">= 30000",
    "Session, us per step": "<= 40",
}


@dataclass
class Method:
    """A way to run the model.

    Attributes
    ----------
    steps : float
        Of all insertions together, in one call.
    call : callable
    alone : bool
        Whether it runs on one thread, and is timed by that thread's clock.
    elsewhere : bool
        Whether other processes do the work: their processor time is not seen.
    every : int
        It is run in every so many-th round.
    passes : float
        Newton passes per step; NaN: not counted.
    tips : array
        Deflections u of the tip, of the sets compared, mm.
    """

    steps: float
    call: Callable[[], object]
    alone: bool = True
    elsewhere: bool = False
    every: int = 1
    passes: float = np.nan
    tips: Floats = field(default_factory=lambda: np.empty(0))
    wall: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)

    def run(self) -> None:
        """Call it for a while and note the time per step, us."""
        self.call()  # brings its own arrays into the caches
        if not self.alone:
            for _ in range(BURSTS):
                time.sleep(PAUSE)
                self._time(time.process_time, 1)
            return
        begin = time.perf_counter()
        self.call()
        self._time(time.thread_time, max(1, round(LEAST / (time.perf_counter() - begin))))

    def _time(self, clock: Callable[[], float], repeats: int) -> None:
        begin, begin_wall = clock(), time.perf_counter()
        for _ in range(repeats):
            self.call()
        per_step = 1e6 / (repeats * self.steps)
        self.wall.append((time.perf_counter() - begin_wall) * per_step)
        self.processor.append(np.nan if self.elsewhere else (clock() - begin) * per_step)

    def figures(self) -> dict[str, float]:
        """Return what was found."""
        taken = np.median(self.processor) if self.alone else min(self.wall)
        return {
            "us": float(taken),
            "us_wall_median": float(np.median(self.wall)),
            "us_processor": float(np.median(self.processor)),
            "insertions_per_s": 1e6 / (float(taken) * STEPS),
            "passes_per_step": self.passes,
        }


def measure_baseline(tolerance: float, solve: Callable[..., Floats], every: int, compared: int) -> Method:
    """Return the full needle of NumPy and SciPy."""
    sets = batch(COMPARED, tolerance)
    needles = [FullNeedle(*_arguments(sets, i), tolerance) for i in range(compared)]
    tips = np.array([needle.insertion(lambda *a, n=needle: solve(n, *a)) for needle in needles])
    passes = float(np.mean([needle.passes for needle in needles])) / STEPS
    first = needles[0]
    call = functools.partial(first.insertion, lambda *a: solve(first, *a))
    return Method(STEPS, call, every=every, passes=passes, tips=tips)


def _arguments(sets: Batch, i: int) -> tuple[object, Tissue, Step]:
    needle, tissue, steps, _ = sets.pick(i)
    return needle, tissue, steps[0]


def scalar(tolerance: float) -> Method:
    """Return the compiled scalar kernel, set after set."""
    sets = batch(32, tolerance)
    inputs = [sets.pick(i) for i in range(len(sets))]
    shapes = [simulate_steps(*one) for one in inputs]
    tips = np.array([shape.u[-1] for shape in shapes[:COMPARED]])
    passes = float(np.mean([shape.iterations for shape in shapes])) / STEPS
    return Method(
        STEPS * len(sets), lambda: [simulate_steps(*one) for one in inputs], passes=passes, tips=tips
    )


def pool(tolerance: float, workers: ProcessPoolExecutor) -> Method:
    """Return the scalar kernel in processes that are sent arrays of parameters and send tips back."""
    sets = batch(256, tolerance)
    parts = [(sets.mu[i : i + 32], sets.shape[i : i + 32], sets.offset[i : i + 32], tolerance)
             for i in range(0, len(sets), 32)]  # fmt: skip

    def call() -> Floats:
        return np.concatenate(list(workers.map(_insert, parts)))

    return Method(STEPS * len(sets), call, False, elsewhere=True, tips=call()[:COMPARED])


def _insert(sets: tuple[Floats, Floats, Floats, float]) -> Floats:
    """Return the tips of some sets; runs in another process."""
    *columns, tolerance = sets
    rules = ModelOptions(tolerance=tolerance)
    return np.array([
        simulate_steps(
            NEEDLE, Tissue(mu, shape, TISSUE.boundaries), (Step(DEPTH, Bevel(offset)),), rules
        ).u[-1]
        for mu, shape, offset in zip(*columns, strict=True)
    ])  # fmt: skip


def session(tolerance: float, step: float) -> Method:
    """Return a session that inserts in steps of so many mm."""
    count = round(DEPTH / step)
    rules = ModelOptions(tolerance=tolerance)

    def insert(tissue: Tissue = TISSUE, bevel: Bevel = BEVEL) -> Session:
        session = Session(NEEDLE, tissue, bevel, rules=rules)
        for _ in range(count):
            session.step(step)
        return session

    sets, tips = batch(COMPARED, tolerance), []
    for i in range(COMPARED):
        _, tissue, end = _arguments(sets, i)
        at_end = insert(tissue, end.bevel)
        tips.append(at_end.step(DEPTH - at_end.depth).u[-1])
    return Method(count, insert, tips=np.array(tips))


def base_moves(tolerance: float) -> Method:
    """Return a session whose base moves back and forth while the tip stands at the whole depth."""
    session = Session(NEEDLE, TISSUE, BEVEL, rules=ModelOptions(tolerance=tolerance))
    for _ in range(STEPS):
        session.step(1.0)
    moves = np.random.default_rng(2).normal(size=(100, 2)) * (1.0, 0.005)  # mm, 1; none comes twice

    def call() -> None:
        for y, slope in moves + np.random.default_rng().uniform(0, 1e-6):
            session.step(base=(y, slope))

    return Method(len(moves), call)


def lanes(sets: Sequence[Batch], threads: int) -> Method:
    """Return the lanes."""
    steps = [step.depth for some in sets for step in some.steps for _ in range(len(some))]
    found = simulate_batches(sets, threads)
    passes = sum(float(shapes.iterations.sum()) for shapes in found) / sum(steps)
    tips = found[0].u[:COMPARED, -1] if len(sets) == 1 else np.empty(0)
    return Method(sum(steps), lambda: simulate_batches(sets, threads), threads == 1, passes=passes, tips=tips)


def with_jax(tolerance: float, count: int) -> Method:
    """Return the model in JAX, on as many threads as it likes."""
    from jax_lanes import compile_batch

    call, steps = compile_batch(batch(count, tolerance))
    tips, passes = call()
    return Method(
        steps * count, call, False, every=3, passes=float(passes.mean()) / steps, tips=tips[:COMPARED]
    )


def ways(tolerance: float, workers: ProcessPoolExecutor) -> dict[str, Method]:
    """Return all ways to run the model, warm."""
    found = {
        "dense NumPy, element by element": measure_baseline(tolerance, FullNeedle.dense, 5, 1),
        "solveh_banded, full needle": measure_baseline(tolerance, FullNeedle.banded, 1, COMPARED),
        "scalar kernel": scalar(tolerance),
        f"scalar kernel, {POOL} processes": pool(tolerance, workers),
        "Session, steps of 1 mm": session(tolerance, 1.0),
        "Session, steps of 0.1 mm": session(tolerance, 0.1),
        "Session, base moves at 55 mm": base_moves(tolerance),
    }
    for count in SETS:
        for threads in (1, 2):
            found[f"lanes, {count} sets, {threads} thread{'s' * (threads > 1)}"] = lanes(
                [batch(count, tolerance)], threads
            )
    ragged = [batch(32, tolerance, float(depth)) for depth in RAGGED]
    for threads in (1, 2):
        found[f"lanes, 47 depths x 32, {threads} thread{'s' * (threads > 1)}"] = lanes(ragged, threads)
    if importlib.util.find_spec("jax"):
        for count in (32, 256):
            found[f"JAX, {count} sets"] = with_jax(tolerance, count)
    return found


def measure(rounds: int) -> dict[str, dict[str, dict[str, float]]]:
    """Return the figures of every way, by tolerance."""
    with ProcessPoolExecutor(POOL, mp_context=multiprocessing.get_context("spawn")) as workers:
        table = {tolerance: ways(tolerance, workers) for tolerance in TOLERANCES}
        for n in range(rounds):
            for some in table.values():
                for way in some.values():
                    if n % way.every == 0:
                        way.run()
    figures = {}
    for tolerance, some in table.items():
        expected = some["scalar kernel"].tips
        column = {name: way.figures() for name, way in some.items()}
        for name, way in some.items():
            own = column[name]
            own["times_banded"] = column["solveh_banded, full needle"]["us"] / own["us"]
            own["times_scalar"] = column["scalar kernel"]["us"] / own["us"]
            differ = np.abs(way.tips - expected[: len(way.tips)])
            own["tip_differs_mm"] = float(np.max(differ)) if len(differ) else np.nan
        figures[f"{tolerance:g}"] = column
    return figures


def show(figures: dict[str, dict[str, dict[str, float]]], rounds: int) -> None:
    """Print the figures as tables."""
    load = " ".join(f"{value:.1f}" for value in os.getloadavg())
    print(f"{rounds} rounds, {len(os.sched_getaffinity(0))} cores, load average {load}")
    head = ("us", "wall", "processor", "insertions/s", "x banded", "x scalar", "passes", "tip differs")
    for tolerance, column in figures.items():
        print(f"\ntolerance {tolerance} mm; us per step (and lane)")
        print(f"{'':38s}" + "".join(f"{text:>13s}" for text in head))
        for name, own in column.items():
            print(f"{name:38s}" + "".join(f"{value:13.4g}" for value in own.values()))
        worst = np.nanmax([own["tip_differs_mm"] for own in column.values()])
        print(f"largest difference of a tip from the scalar kernel's: {worst:.2g} mm")
    if not importlib.util.find_spec("jax"):
        print("\njax is not installed: its rows are left out")
    print("\naims, two threads: " + "; ".join(f"{name} {value}" for name, value in GOALS.items()))


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--rounds", type=int, default=15)
    arguments = parser.parse_args()
    figures = measure(arguments.rounds)
    if arguments.json:
        print(json.dumps(figures, indent=2))
    else:
        show(figures, arguments.rounds)


if __name__ == "__main__":
    main()
