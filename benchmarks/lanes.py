"""Many parameter sets side by side: time per step and set, of shapes and of derivatives, and their errors.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/lanes.py [--rounds N] [--beside-python PYTHON]
    ... --errors      largest errors against full passes to 1e-11 mm
    ... --features    lanes beside one needle at a time, for each kind of input

The insertion of `reference_problem`, 512 sets within 30 % of nominal or over broad priors. One thread is
timed by its processor time, two by the clock. `one full pass a step` linearises all elements once at every
stop, as derivatives must: a guide in the tissue, which the tip does not reach, keeps the kernel from its
quick scheme. Derivatives are those by mu and alpha of four layers and the bevel's offset, to 1e-9 mm.
"""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from in_turns import HERE, make_parser, measure, print_table, time_call
from reference_problem import BEVEL, DEPTH, batch

from needlefit.mechanics.batch import Batch, linearize_steps, simulate_batches
from needlefit.mechanics.control import Controls, Guide, ModelOptions, Step, TrackedTip
from needlefit.mechanics.simulate import simulate_steps

try:
    from needlefit.mechanics.batch import linearize_batches
except ImportError:  # of an earlier commit: one set after the other
    linearize_batches = None

SETS, ERROR_SETS, FEATURE_SETS = 512, 10_000, 128
TOLERANCE_MM = 1e-7
FULL_PASS, JACOBIAN = "one full pass a step, 1 thread", "Jacobian of nine parameters, 1 thread"


def spread_over_priors(sets: Batch) -> Batch:
    """Return as many sets over broad priors."""
    rng, count = np.random.default_rng(5), len(sets)
    return replace(
        sets,
        mu=10 ** rng.uniform(np.log10(0.05), np.log10(60), (count, 4)),
        alpha=rng.uniform(-3, 3, (count, 4)),
        offset=rng.uniform(0, 0.2, count),
    )


def take_full_passes(sets: Batch) -> Batch:
    """Return the same insertion, with one pass at each stop in which all elements are linearised."""
    guide = Guide(DEPTH + 10.0, 0.0, None, in_tissue=True)
    step = Step(DEPTH, BEVEL, Controls(guides=(guide,)))
    return replace(sets, steps=(step,), rules=replace(sets.rules, tolerance=np.inf))


def list_cases() -> dict[str, Callable[[], float]]:
    """Return the cases; each gives microseconds per step and set."""
    nominal = batch(SETS, TOLERANCE_MM)
    priors = spread_over_priors(nominal)
    fine = batch(SETS, 1e-9)

    def time_sets(sets: Batch, threads: int) -> Callable[[], float]:
        clock = time.process_time if threads == 1 else time.perf_counter
        return lambda: 1e6 * time_call(lambda: simulate_batches([sets], threads), clock) / len(sets) / DEPTH

    def differentiate() -> None:
        if linearize_batches is None:
            for i in range(8):
                linearize_steps(*fine.pick(i))
        else:
            linearize_batches([fine], ("mu", "shape", "offset"), 1)

    def time_jacobians() -> float:
        sets = 8 if linearize_batches is None else len(fine)
        return 1e6 * time_call(differentiate) / sets / DEPTH

    return {
        "nominal, 1 thread": time_sets(nominal, 1),
        "nominal, 2 threads": time_sets(nominal, 2),
        "priors, 1 thread": time_sets(priors, 1),
        "priors, 2 threads": time_sets(priors, 2),
        FULL_PASS: time_sets(take_full_passes(nominal), 1),
        JACOBIAN: time_jacobians,
    }


def print_errors() -> None:
    """Print the largest errors of shapes, mm, of nominal sets and over broad priors."""
    many = batch(ERROR_SETS, TOLERANCE_MM)
    for name, sets in {"nominal": many, "priors": spread_over_priors(many)}.items():
        (found,) = simulate_batches([sets])
        (exact,) = simulate_batches([replace(sets, rules=ModelOptions(tolerance=1e-11))])
        errors = np.abs(found.u - exact.u).max(axis=1)[found.converged & exact.converged]
        print(
            f"{name}: {len(errors)} of {len(sets)} sets, largest {errors.max():.2g}, "
            f"99 % below {np.quantile(errors, 0.99):.2g} mm"
        )


def make_features() -> dict[str, Batch]:
    """Return the reference insertion with each kind of input."""
    plain = batch(FEATURE_SETS, TOLERANCE_MM)
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
        "tip tracked every millimetre": replace(plain, steps=tuple(steps)),
        "base moved every millimetre": replace(plain, steps=tuple(moved)),
    }


def print_features() -> None:
    """Print processor time per mm of depth and set, in lanes and one needle at a time."""
    for name, sets in make_features().items():
        (shapes,) = simulate_batches([sets], 1)
        few = [sets.pick(i) for i in range(8)]
        differ = max(np.abs(shapes.u[i] - simulate_steps(*one).u).max() for i, one in enumerate(few))
        lanes = 1e6 * time_call(lambda sets=sets: simulate_batches([sets], 1)) / len(sets) / DEPTH
        alone = 1e6 * time_call(lambda few=few: [simulate_steps(*one) for one in few]) / len(few) / DEPTH
        print(
            f"{name:30s} lanes {lanes:5.2f} us, alone {alone:5.1f}, ratio {alone / lanes:4.1f}, "
            f"passes per mm {shapes.iterations.mean() / DEPTH:.1f}, difference {differ:.1g} mm"
        )


def main() -> None:
    """Print the figures."""
    parser = make_parser(__doc__.splitlines()[0], rounds=20)
    parser.add_argument("--errors", action="store_true")
    parser.add_argument("--features", action="store_true")
    options = parser.parse_args()
    if options.errors:
        print_errors()
    elif options.features:
        print_features()
    else:
        found = measure(list_cases, options)
        print_table(found, "us per step and set")
        times = found[JACOBIAN][HERE] / found[FULL_PASS][HERE]
        print(f"Jacobian, times one full pass a step: {np.median(times):.2f}")


if __name__ == "__main__":
    main()
