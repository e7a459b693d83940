"""What a tune costs, and what of it the verdict: python benchmarks/verdict.py phantom2 9 2 32.

Arguments: a fit, how many of its insertions, threads, starts. Lines: the fit of the posterior, the one of the
metric beside it, all profiles about the first, and their sum; then a line per profile.
"""

import sys
import time
from dataclasses import replace

from needlefit.inference.fit import Callbacks
from needlefit.inference.identifiability.identify import profile_parameters
from needlefit.inference.optimize import minimize
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import load
from needlefit.schemas.study import FitRecord
from needlefit.studies.job import Settings, metric_recipe, prepare


def main(name: str, count: int, jobs: int, starts: int) -> None:
    job = prepare(name, load(find_file("fit", name), FitRecord), Settings())
    recipe = job.recipe.model_copy(update={"starts": starts})
    problem = replace(job.problem(job.folds[0]), insertions=job.folds[0].tune[:count])
    began = time.perf_counter(), time.process_time()
    fit = minimize(problem, recipe, random_stream(recipe.seed, "verdict"), Callbacks(jobs=jobs))
    between = time.perf_counter(), time.process_time()
    minimize(problem, metric_recipe(recipe), random_stream(recipe.seed, "metric"), Callbacks(jobs=jobs))
    beside = time.perf_counter(), time.process_time()
    examination = profile_parameters(problem, fit, jobs)
    ended = time.perf_counter(), time.process_time()
    parts = ((began, between), (between, beside), (beside, ended), (began, ended))
    took = [(b[0] - a[0], b[1] - a[1]) for a, b in parts]
    print(f"{len(problem.insertions)} insertions, {len(fit.starts)} starts, {jobs} threads")
    searched = f"{fit.evaluations} evaluations, {fit.gradients} of them with derivatives"
    print(f"fit:      {searched}, {format_times(took[0])}")
    print(f"metric:   {format_times(took[1])}")
    print(f"profiles: {examination.evaluations} Jacobians, {format_times(took[2])}")
    print(f"together: {format_times(took[3])}")
    for one in examination.parameters:
        profile = one.profile
        counts = f"{len(profile.at):3d} points, {profile.evaluations:4d} Jacobians"
        print(f"  {one.name:10s} {counts}, ends {' and '.join(profile.ends)}")


def format_times(took: tuple[float, float]) -> str:
    return f"{took[0]:.1f} s, {took[1]:.1f} s of processor"


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:5]))
