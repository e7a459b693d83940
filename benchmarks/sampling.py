"""How many independent draws the sampler gets from a density, by its own moves and by emcee's.

    OPENBLAS_NUM_THREADS=1 python benchmarks/sampling.py [--targets study2 phantom1] [--densities 20000]
        [--moves default stretch de] [--jobs 2]

Each target, a study or a fit (`stereo` needs NEEDLEFIT_REAL_DATA), is fitted and sampled by importance first,
which is not counted. Every run spends all its densities, whatever has converged. `per_1000` is the number of
independent draws of the slowest quantity, of all walkers, for 1000 densities; `ms` the processor time of one.
"""

import argparse
import time

import numpy as np
from emcee import moves

from needlefit.errors import ConfigError
from needlefit.inference.fit import Callbacks
from needlefit.inference.optimize import minimize
from needlefit.inference.sampling import sample as sampler
from needlefit.inference.sampling.importance import sample_about_fit
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import load
from needlefit.schemas.recipe import SampleRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.job import Job, Settings
from needlefit.studies.load import load_study

MOVES = {
    "default": None,
    "stretch": [(moves.StretchMove(), 1.0)],
    "de": [(moves.DEMove(), 1.0)],
    "de+snooker": [(moves.DEMove(), 0.8), (moves.DESnookerMove(), 0.2)],
}


def prepare_target(target: str) -> Job:
    """Return the fit of a target, or of the study of this name."""
    try:
        record = load(find_file("study", target), StudyRecord).tuning()
    except ConfigError:
        record = load(find_file("fit", target), FitRecord)
    return load_study(target, record, Settings())


def main() -> None:
    """Print a row for each target and kind of moves."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--targets", nargs="+", default=["study2", "phantom1", "stereo"])
    parser.add_argument("--densities", type=int, default=20_000)
    parser.add_argument("--moves", nargs="+", choices=MOVES, default=list(MOVES))
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    # more draws than any run gets: none ends before its densities are spent
    settings = SampleRecord(independent_draws=10**9, densities=options.densities)
    print(f"{'target':10} {'moves':12} {'steps':>6} {'tau':>7} {'acceptance':>10} {'per_1000':>9} {'ms':>6}")
    for target in options.targets:
        job = prepare_target(target)
        problem = job.problem(job.folds[0]).searched
        stream = random_stream(job.recipe.seed, target, "starts")
        fit = minimize(problem, job.recipe, stream, Callbacks(jobs=options.jobs))
        begin = sample_about_fit(problem, fit, random_stream(1, target, "importance"), options.jobs)
        for name in options.moves:
            own = sampler.make_sampler_moves
            if MOVES[name] is not None:
                sampler.make_sampler_moves = lambda _, name=name: MOVES[name]
            clock = time.process_time()
            rng = random_stream(1, target, "posterior")
            found = sampler.sample(problem, begin, settings, rng, Callbacks(jobs=options.jobs))
            spent = time.process_time() - clock
            sampler.make_sampler_moves = own
            steps, tau = found.draws.shape[1], float(np.max(found.autocorrelation_time))
            draws, densities = float(np.min(found.ess)), steps * len(found.draws)
            accepted, each = float(np.mean(found.acceptance_fraction)), 1000 * spent / densities
            row = f"{target:10} {name:12} {steps:6d} {tau:7.1f} {accepted:10.2f}"
            print(f"{row} {1000 * draws / densities:9.1f} {each:6.2f}", flush=True)


if __name__ == "__main__":
    main()
