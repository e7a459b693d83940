"""What needlefit takes beside general programs on the same model and density, in processor time.

    pip install lmfit
    OPENBLAS_NUM_THREADS=1 python benchmarks/peers.py [--target study2] [--rounds 3]

- model: SciPy's banded solver for as many systems as the kernel solves in one insertion (that of
  `reference_problem`), without their assembly, beside the whole insertion by the kernel.
- fit: lmfit (L-BFGS-B, differences) on our log posterior, beside our least squares, from the same starts.
- draws: emcee with its own moves on our log posterior, beside our importance sampling, for each independent
  draw.

Both sides take turns in one process. `ratio` is the median over rounds of theirs over ours. `apart` is by how
much the log posterior of lmfit's best point is lower, and the largest difference of means, in SDs.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from typing import TypeVar

import emcee
import numpy as np
from reference_problem import BEVEL, DEPTH, NEEDLE, TISSUE
from sampling import prepare_target
from scipy.linalg import solve_banded

from needlefit.inference.fit import Callbacks, Fit
from needlefit.inference.optimize import minimize, starting_points
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import sample_about_fit
from needlefit.mechanics.control import ModelOptions, Step
from needlefit.mechanics.simulate import simulate_steps

Found = TypeVar("Found")
STARTS = 4  #: of a fit
WALKERS, STEPS = 32, 2000  #: of emcee's ensemble; the first fifth of its steps is left out
REPEATS = 50  #: of one insertion


def measure(work: Callable[[], Found]) -> tuple[float, Found]:
    """Return the processor time of some work, s, and what it gives."""
    clock = time.process_time()
    found = work()
    return time.process_time() - clock, found


def compare_models() -> tuple[float, float]:
    """Return the ratio for one insertion."""
    rules = ModelOptions()
    ours, shape = measure(
        lambda: [simulate_steps(NEEDLE, TISSUE, (Step(DEPTH, BEVEL),), rules) for _ in range(REPEATS)][-1]
    )
    unknowns = 2 * len(shape.x)  # deflection and slope of each node, coupled to those of its neighbours
    bands, load = np.ones((7, unknowns)), np.ones(unknowns)
    bands[3] = 10.0
    theirs, _ = measure(
        lambda: [solve_banded((3, 3), bands, load) for _ in range(shape.iterations * REPEATS)]
    )
    return theirs / ours, 0.0


def compare_fits(problem: Problem, fit: Callable[[], Fit]) -> tuple[float, float]:
    """Return the ratio for a fit, and how much lower lmfit's log posterior is."""
    try:
        import lmfit
    except ImportError:
        raise SystemExit("lmfit is missing: pip install lmfit") from None

    def by_lmfit() -> float:
        best = -np.inf
        for start in starting_points(problem.lower, problem.upper, STARTS, np.random.default_rng(1)):
            given = lmfit.Parameters()
            for name, value, low, high in zip(
                problem.names, start, problem.lower, problem.upper, strict=True
            ):
                given.add(name, value, min=low, max=high)
            found = lmfit.minimize(
                lambda at: -problem.log_posterior(list(at.valuesdict().values())), given, method="lbfgsb"
            )
            best = max(best, problem.log_posterior(list(found.params.valuesdict().values())))
        return best

    theirs, best = measure(by_lmfit)
    ours, own = measure(fit)
    return theirs / ours, problem.log_posterior(own.theta) - best


def compare_draws(problem: Problem, fit: Fit) -> tuple[float, float]:
    """Return the ratio for an independent draw, and the largest difference of means in SDs."""
    ours, found = measure(lambda: sample_about_fit(problem, fit, np.random.default_rng(1)))
    weights = np.exp(found.log_weights)
    mean = weights @ found.thetas
    sd = np.sqrt(weights @ (found.thetas - mean) ** 2)
    begin = np.clip(
        np.random.default_rng(2).normal(mean, 0.3 * sd, (WALKERS, len(mean))), problem.lower, problem.upper
    )
    ensemble = emcee.EnsembleSampler(WALKERS, len(mean), problem.log_posteriors, vectorize=True)
    theirs, _ = measure(lambda: ensemble.run_mcmc(begin, STEPS))
    chain = ensemble.get_chain(discard=STEPS // 5)
    independent = chain.size / len(mean) / ensemble.get_autocorr_time(discard=STEPS // 5, quiet=True).max()
    apart = np.abs(chain.reshape(-1, len(mean)).mean(axis=0) - mean) / sd
    return theirs / independent / (ours / found.effective_sample_size), float(apart.max())


def main() -> None:
    """Print a row for each comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--target", default="study2")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    job = prepare_target(options.target)
    problem, recipe = job.problem(job.folds[0]).searched, job.recipe.model_copy(update={"starts": STARTS})

    def fit() -> Fit:
        return minimize(problem, recipe, np.random.default_rng(1), Callbacks())

    best = fit()
    rows = {
        "model": compare_models,
        "fit": lambda: compare_fits(problem, fit),
        "draws": lambda: compare_draws(problem, best),
    }
    for name, compare in rows.items():
        ratios, apart = zip(*(compare() for _ in range(options.rounds)), strict=True)
        print(f"{name:8s} ratio {statistics.median(ratios):8.1f}   apart {max(apart):.2g}", flush=True)


if __name__ == "__main__":
    main()
