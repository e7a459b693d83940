"""How many independent draws the sampler gets from a density, by its own moves and by emcee's.

    OPENBLAS_NUM_THREADS=1 python benchmarks/sampling.py [--targets study2 phantom1] [--densities 20000]
        [--moves default stretch de] [--jobs 2]

Each target, a study or a fit (`stereo` needs NEEDLEFIT_REAL_DATA), is fitted and sampled by importance first,
which is not counted. Every run spends all its densities, whatever has converged. `per_1000` is the number of
independent draws of the slowest quantity, of all walkers, for 1000 densities; `ms` the processor time of one.

    python benchmarks/sampling.py --repeats 40

makes the chains of `tune`, which end at 400 independent draws, so often, each from draws by importance of its
own, and one chain of 50 autocorrelation times. It prints their length, and in standard deviations of the
posterior how far the medians and the ends of the 95 % intervals scatter, what so many independent draws let
expect, and how far their means lie from the long chain's.
"""

import argparse
import time

import numpy as np
from emcee import moves

from needlefit.errors import ConfigError
from needlefit.inference.fit import Callbacks
from needlefit.inference.optimize import minimize
from needlefit.inference.parameter_names import HYPERPARAMETERS
from needlefit.inference.sampling import sample as sampler
from needlefit.inference.sampling.importance import sample_about_fit
from needlefit.inference.sampling.posterior import Posterior
from needlefit.inference.sampling.samplers import emcee as emcee_sampler
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


#: standard errors of a median, and of the ends of a 95 % interval, of one independent draw, in SDs
QUANTILE_ERRORS = {0.5: 1.25, 0.025: 2.67, 0.975: 2.67}
LONG_CHAIN_TIMES = 50  #: autocorrelation times, which emcee's documents ask for


def repeat_chains(target: str, repeats: int, jobs: int) -> None:
    """Print how the short chains of a target scatter, and how they lie about a long one."""
    job = prepare_target(target)
    problem = job.problem(job.folds[0]).searched
    fit = minimize(
        problem, job.recipe, random_stream(job.recipe.seed, target, "starts"), Callbacks(jobs=jobs)
    )

    def run(number: int, settings: SampleRecord) -> Posterior:
        begin = sample_about_fit(problem, fit, random_stream(number, target, "importance"), jobs)
        found = sampler.sample(problem, begin, settings, random_stream(number, target, "posterior"))
        assert found is not None
        return found

    short = [run(number, job.recipe.sample) for number in range(1, repeats + 1)]
    tau = float(np.mean([one.autocorrelation_time.max() for one in short]))
    steps = int(LONG_CHAIN_TIMES * tau)
    long = run(0, SampleRecord(independent_draws=10**9, densities=steps * job.recipe.sample.walkers))
    kept = [n for n, name in enumerate(long.names) if name not in HYPERPARAMETERS]
    every = [np.log(one.draws.reshape(-1, len(one.names))[:, kept]) for one in (*short, long)]
    sd = every[-1].std(axis=0)
    ess = np.mean([one.ess.min() for one in short])
    lengths = np.mean([one.draws.shape[1] for one in short]) / tau
    for level, error in QUANTILE_ERRORS.items():
        found = np.array([np.quantile(one, level, axis=0) for one in every]) / sd
        scatter, off = found[:-1].std(axis=0).max(), np.abs(found[:-1].mean(axis=0) - found[-1]).max()
        expected, chance = error / np.sqrt(ess), error / np.sqrt(long.ess.min())
        numbers = f"{scatter:8.3f} {expected:8.3f} {off:8.3f} {chance:8.3f}"
        print(f"{target:10} {lengths:5.1f} {level:6.3f} {numbers}", flush=True)


def main() -> None:
    """Print a row for each target and kind of moves."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--targets", nargs="+", default=["study2", "phantom1", "stereo"])
    parser.add_argument("--densities", type=int, default=20_000)
    parser.add_argument("--moves", nargs="+", choices=MOVES, default=list(MOVES))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=0)
    options = parser.parse_args()
    if options.repeats:
        print("target     times  level  scatter expected  off long   chance")
        for target in options.targets:
            repeat_chains(target, options.repeats, options.jobs)
        return
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
            own = emcee_sampler.make_moves
            if MOVES[name] is not None:
                emcee_sampler.make_moves = lambda _, name=name: MOVES[name]
            clock = time.process_time()
            rng = random_stream(1, target, "posterior")
            found = sampler.sample(problem, begin, settings, rng, Callbacks(jobs=options.jobs))
            spent = time.process_time() - clock
            emcee_sampler.make_moves = own
            steps, tau = found.draws.shape[1], float(np.max(found.autocorrelation_time))
            draws, densities = float(np.min(found.ess)), steps * len(found.draws)
            accepted, each = float(np.mean(found.acceptance_fraction)), 1000 * spent / densities
            row = f"{target:10} {name:12} {steps:6d} {tau:7.1f} {accepted:10.2f}"
            print(f"{row} {1000 * draws / densities:9.1f} {each:6.2f}", flush=True)


if __name__ == "__main__":
    main()
