"""The lanes beside the limit of the machine: packed instructions, peak of multiply-adds, fraction reached.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/lanes.py [--json] [--rounds N]
    ... --beside FOLDER     time per step and set beside the package of another checkout, in turns
    ... --priors            time per step and set over broad priors, beside nominal sets, in turns
    ... --errors            largest errors against full passes to 1e-11 mm
    ... --features          lanes beside the scalar kernel, for each kind of input

The loops of `kernel.lanes.passes` are compiled anew here, to read which instructions they became: of the
arithmetic on doubles, all but a rest has to be packed, or the compiler has given up on a loop.

The peak is measured, on one core and on both: chains of multiply-adds on rows of doubles, independent of
each other, held in registers. Arithmetic per element (floating-point operations; a division counts as one;
abs, max and comparisons as none), read off the source of `kernel.lanes.passes`:

| | full pass | half pass |
|---|---|---|
| u at four points | 28 | 28 |
| e, over | 6 | 6 |
| k, with d(k e)/de / without | 80 | 40 |
| right-hand side at the points | 12 | 12 |
| bending and stiffness | 84 | 0 |
| load | 28 | 28 |
| eliminate, z, S, r | 50 | 16 |
| `substitute_back` | 9 | 9 |
| all | 297 | 139 |

Per step a lane makes one half (chord) pass over the needle and, where it has not converged, another; the full
pass over three cells (FULL each) is counted too, but not the full pass that every eighth node makes instead,
the two further substitutions, the work that a block does for lanes that have already converged, nor what is
done once a step. The fraction is thus that of *useful* arithmetic, and
of a peak that only pure multiply-adds can reach. `full_regular` and `chord_regular` are these loops alone, on
one element that stays in the first cache.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
from needlefit.mechanics.kernel.lanes import passes
from needlefit.mechanics.kernel.lanes.passes import chord_regular, full_regular
from needlefit.mechanics.kernel.lanes.tables import LANES, LAYER_ROWS, NODE_ROWS, POINT_COLUMNS
from numpy.typing import NDArray
from reference_problem import BEVEL, DEPTH, batch

from needlefit.mechanics.batch import Batch
from needlefit.mechanics.control import Controls, Guide, Step, TrackedTip
from needlefit.mechanics.lanes import simulate_batches
from needlefit.mechanics.simulate import simulate_steps

Floats = NDArray[np.float64]
FULL, HALF, BACK = 297, 139, 9
TOLERANCES = (1e-7, 1e-9)  # mm
ROW, CHAIN, REPEATS = 512, 16, 40000  # doubles, multiply-adds on each, times
SETS = 512
LOOPS = ("full_regular", "chord_regular", "full_interval", "chord_interval", "full_sums", "chord_sums",
         "solve_tip", "update_tip", "substitute_back", "shift_load", "add_compliance",
         "extrapolate_node", "friction_point")  # fmt: skip
TABLES = ("table", "bending", "shapes")  # the arguments that have two dimensions
FEATURE_SETS = 128
TIMED_SETS = 1024
ARITHMETIC = re.compile(r"\bv?(?:add|sub|mul|div|fn?m(?:add|sub)(?:132|213|231))([ps])d\b.*")


@numba.njit(nogil=True, fastmath={"contract"})
def multiply_adds(row: Floats, a: float, b: float, repeats: int) -> None:
    """Make CHAIN multiply-adds on every number of a row, again and again."""
    for _ in range(repeats):
        for l in range(ROW):  # noqa: E741
            x = row[l]
            x = x * a + b
            x = x * a + b
            x = x * a + b
            x = x * a + b
            x = x * a + b
            x = x * a + b
            x = x * a + b
            x = x * a + b
            x = x * a + b
            x = x * a + b
            x = x * a + b
            x = x * a + b
            x = x * a + b
            x = x * a + b
            x = x * a + b
            x = x * a + b
            row[l] = x


@numba.njit(nogil=True)
def loop_alone(full: bool, state: Floats, layer: Floats, table: Floats, work: Floats, repeats: int) -> None:
    """Run the loop over the lanes of one element, again and again."""
    nought, own, busy = np.uint64(0), np.uint64(NODE_ROWS * LANES), np.ones(3 * LANES)
    for _ in range(repeats):
        if full:
            full_regular(
                state, nought, layer, nought, layer, nought, nought, table, nought, layer, work, own, busy
            )
        else:
            chord_regular(state, nought, layer, nought, layer, nought, nought, table, nought, work, own, busy)


def arithmetic(assembly: str) -> dict[str, int]:
    """Count the instructions on doubles: packed, by the width of their registers, and single."""
    counts = {"zmm": 0, "ymm": 0, "xmm": 0, "single": 0}
    for found in ARITHMETIC.finditer(assembly):
        if found[1] == "s":
            counts["single"] += 1
        else:
            counts[next((name for name in ("zmm", "ymm") if name in found[0]), "xmm")] += 1
    return counts


def anew(name: str) -> dict[str, int]:
    """Compile a loop of the kernel anew and count its instructions; what comes from the cache has no text."""
    loop = getattr(passes, name).py_func
    kinds = [
        numba.uint64
        if hint is np.uint64
        else numba.float64
        if hint is float
        else numba.float64[:, ::1]
        if of in TABLES
        else numba.float64[::1]
        for of, hint in loop.__annotations__.items()
        if of != "return"
    ]
    fresh = numba.njit(tuple(kinds), nogil=True, error_model="numpy", fastmath=passes.FASTMATH)(loop)
    return arithmetic(fresh.inspect_asm(fresh.signatures[0]))


def rate(work: float, threads: int, call: Callable[[int], object], rounds: int) -> dict[str, float]:
    """Return 10^9 operations per second.

    Of all threads by the clock on the wall, in the best round; of one by processor time, the median.
    """
    wall, processor = [], []
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(rounds):
            time.sleep(0.02)  # a program that has rested is given the cores it asks for
            begin, begin_wall = time.process_time(), time.perf_counter()
            list(pool.map(call, range(threads)))
            processor.append((time.process_time() - begin) / threads)
            wall.append(time.perf_counter() - begin_wall)
    return {
        "best": work * threads / min(wall) / 1e9,
        "per_thread": work / float(np.median(processor)) / 1e9,
    }


def measure(rounds: int) -> dict[str, object]:
    """Return all figures; peak and lanes in turns."""
    rows = [np.linspace(0.5, 1.5, ROW) for _ in range(2)]
    multiply_adds(rows[0], 0.999, 0.001, 1)
    figures: dict[str, object] = {
        "instructions": {name: anew(name) for name in LOOPS},
        "peak_instructions": arithmetic(multiply_adds.inspect_asm(multiply_adds.signatures[0])),
    }
    steps = round(DEPTH)
    state, layer = np.zeros(4 * LANES), np.ones(LAYER_ROWS * LANES)
    table, work = np.ones((1, 4 * POINT_COLUMNS + 4)), np.ones(2 * NODE_ROWS * LANES)
    for full, name, count in ((True, "full_regular", FULL), (False, "chord_regular", HALF)):
        loop_alone(full, state, layer, table, work, 1)
        figures[name] = rate(
            (count - BACK) * LANES * REPEATS, 1,
            lambda _, full=full: loop_alone(full, state, layer, table, work, REPEATS), rounds,
        )  # fmt: skip
    for threads in (1, 2):
        peak = rate(
            2.0 * ROW * CHAIN * REPEATS, threads,
            lambda i: multiply_adds(rows[i], 0.999, 0.001, REPEATS), rounds,
        )  # fmt: skip
        figures[f"peak_{threads}"] = peak
        for tolerance in TOLERANCES:
            sets = batch(SETS, tolerance)
            (shapes,) = simulate_batches([sets], 1)
            per_step = float(shapes.iterations.mean()) / steps
            elements = steps * (steps + 1) / 2 * SETS
            work = elements * HALF * per_step + 3.0 * steps * SETS * FULL
            # one block of lanes is one task; two callers have a batch each
            reached = rate(work, threads, lambda _, sets=sets: simulate_batches([sets], 1), rounds)
            figures[f"lanes_{threads}_{tolerance:g}"] = {
                **reached,
                "passes_per_step": per_step,
                "flop_per_step": work / SETS / steps,
                "fraction_best": reached["best"] / peak["best"],
                "fraction_per_thread": reached["per_thread"] / peak["per_thread"],
            }
    return figures


def serve() -> None:
    """Answer each line "depth threads" with the time per step and set, us: the best of three calls."""
    for line in sys.stdin:
        depth, threads = line.split()
        sets = [batch(SETS, TOLERANCES[0], float(depth))]
        simulate_batches(sets, int(threads))
        taken = []
        for _ in range(3):
            begin = time.perf_counter()
            simulate_batches(sets, int(threads))
            taken.append(time.perf_counter() - begin)
        print(1e6 * min(taken) / SETS / float(depth), flush=True)


def compare(folder: str, rounds: int) -> None:
    """Print the time per step and set of this package and another, asked in turns by two processes."""
    own = str(Path(__file__).parents[1])
    found: dict[tuple[str, str], list[float]] = {}
    programs = {
        name: subprocess.Popen([sys.executable, __file__, "--serve"], env=os.environ | {"PYTHONPATH": path},
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for name, path in (("here", own), ("beside", folder))
    }  # fmt: skip
    for _ in range(rounds):
        for case in ("14 1", "28 1", "55 1", "110 1", "55 2"):
            for name, program in programs.items():
                print(case, file=program.stdin, flush=True)
                found.setdefault((case, name), []).append(float(program.stdout.readline()))
    for case in dict.fromkeys(case for case, _ in found):
        here, there = (np.array(found[case, name]) for name in programs)
        depth, threads = case.split()
        print(
            f"{depth:>4s} mm, {threads} threads: {np.median(here):.3f} us, beside {np.median(there):.3f}, "
            f"ratio of the rounds {np.median(there / here):.2f} (least {min(there) / min(here):.2f})"
        )
    for program in programs.values():
        program.stdin.close()


def make_kinds(nominal: int, broad: int) -> dict[str, Batch]:
    """Return so many sets about the nominal one, and over broad priors."""
    rng = np.random.default_rng(5)
    priors = replace(
        batch(broad, TOLERANCES[0]),
        mu=10 ** rng.uniform(np.log10(0.05), np.log10(60), (broad, 4)),
        shape=rng.uniform(-3, 3, (broad, 1, 4)),
        offset=rng.uniform(0, 0.2, broad),
    )
    return {"within 30 % of nominal": batch(nominal, TOLERANCES[0]), "priors": priors}


def time_priors(rounds: int) -> None:
    """Print the time per step and set, us of wall, of nominal sets and of those over priors, in turns."""
    kinds, found = make_kinds(TIMED_SETS, TIMED_SETS), {}
    for n in range(rounds + 1):  # the first round is for the caches
        for threads in (1, 2):
            for name, sets in kinds.items():
                begin = time.perf_counter()
                (shapes,) = simulate_batches([sets], threads)
                taken = 1e6 * (time.perf_counter() - begin) / TIMED_SETS / DEPTH
                if n:
                    found.setdefault((name, threads, int((~shapes.converged).sum())), []).append(taken)
    for (name, threads, failed), taken in found.items():
        print(
            f"{name:24s} {threads} threads: least {min(taken):.3f}, median {np.median(taken):.3f} us; "
            f"{failed} of {TIMED_SETS} sets without a solution"
        )


def print_errors(count: int = 10_000) -> None:
    """Print the largest errors of shapes, mm, for nominal sets and broad priors."""
    for name, sets in make_kinds(SETS, count).items():
        (found,) = simulate_batches([sets])
        (exact,) = simulate_batches([replace(sets, rules=replace(sets.rules, tolerance=1e-11))])
        errors = np.abs(found.u - exact.u).max(axis=1)[found.converged & exact.converged]
        print(
            f"{name}: {len(errors)} sets, largest {errors.max():.2g}, "
            f"99 % below {np.quantile(errors, 0.99):.2g} mm"
        )


def make_features() -> dict[str, Batch]:
    """Return the reference insertion with each kind of input."""
    plain = batch(FEATURE_SETS, TOLERANCES[0])
    path = simulate_steps(*plain.pick(0)).tip_track[:, 0]
    steps = [Step(d, BEVEL, Controls(tip=TrackedTip(path[round(d)]))) for d in np.arange(1.0, DEPTH + 1)]
    tracked = Step(DEPTH, BEVEL, Controls(tip=TrackedTip(path[-1] + 0.1)))
    guides = tuple(Guide(x, path[round(x)], None, in_tissue=True) for x in (10.0, 30.0))
    guided = Step(DEPTH, BEVEL, Controls(guides=guides))
    moved = [Step(d, BEVEL, Controls(base_y=0.01 * d)) for d in np.arange(1.0, DEPTH + 1)]
    return {
        "ordinary": plain,
        "friction 0.3": replace(plain, tissue=replace(plain.tissue, friction=np.full(4, 0.3))),
        "two guides in the tissue": replace(plain, steps=(guided,)),
        "tip tracked at the end": replace(plain, steps=(Step(DEPTH, BEVEL), tracked)),
        "tip tracked every millimetre": replace(plain, steps=steps),
        "base moved every millimetre": replace(plain, steps=moved),
    }


def compare_features(rounds: int) -> None:
    """Print processor time per mm of depth and set, of the lanes on one thread and of the scalar kernel."""
    for name, sets in make_features().items():
        found: tuple[list[float], list[float]] = ([], [])
        (shapes,) = simulate_batches([sets], 1)
        few = [sets.pick(i) for i in range(8)]
        errors = [np.abs(shapes.u[i] - simulate_steps(*one).u).max() for i, one in enumerate(few)]
        for _ in range(rounds):
            begin = time.process_time()
            simulate_batches([sets], 1)
            middle = time.process_time()
            for one in few:
                simulate_steps(*one)
            found[0].append(1e6 * (middle - begin) / FEATURE_SETS / DEPTH)
            found[1].append(1e6 * (time.process_time() - middle) / len(few) / DEPTH)
        lanes, scalar = np.median(found, axis=1)
        ratio = np.median(np.array(found[1]) / found[0])
        print(
            f"{name:30s} lanes {lanes:5.2f} us, scalar {scalar:5.1f}, ratio of the rounds {ratio:4.1f}, "
            f"passes per mm {shapes.iterations.mean() / DEPTH:.1f}, difference {max(errors):.1g} mm"
        )


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--beside", metavar="FOLDER")
    parser.add_argument("--priors", action="store_true")
    parser.add_argument("--errors", action="store_true")
    parser.add_argument("--features", action="store_true")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve:
        serve()
        return
    if arguments.beside:
        compare(arguments.beside, arguments.rounds)
        return
    if arguments.features:
        compare_features(arguments.rounds)
        return
    if arguments.priors:
        time_priors(arguments.rounds)
        return
    if arguments.errors:
        print_errors()
        return
    figures = measure(arguments.rounds)
    if arguments.json:
        print(json.dumps(figures, indent=2))
        return
    print(f"{LANES} lanes; load average {os.getloadavg()[0]:.1f}\narithmetic instructions on doubles")
    instructions = figures.pop("instructions")
    instructions["the peak's chain"] = figures.pop("peak_instructions")
    for name, counts in instructions.items():
        print(f"  {name:18s}" + "".join(f"{counts[kind]:6d} {kind}" for kind in counts))
    print("GFLOP/s: all threads, best round by the wall; one thread, median by processor time")
    for name, values in figures.items():
        print(f"  {name:18s}" + "".join(f"  {key} {value:.3g}" for key, value in values.items()))


if __name__ == "__main__":
    main()
