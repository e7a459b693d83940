"""What the identifiability verdict costs beside the fit: python benchmarks/verdict.py phantom2 9 2.

Arguments: a fit, how many of its insertions, threads. The first line is the fit by its recipe, the second
all profiles about it; then a line per profile.
"""

import sys
import time
from dataclasses import replace

from needlefit.inference.examine import examine
from needlefit.inference.optimize import minimize
from needlefit.inference.starts import Watch
from needlefit.project.load import load
from needlefit.project.places import find
from needlefit.project.records.fit import FitRecord
from needlefit.project.streams import stream
from needlefit.validation.job import Settings, prepare


def main(name: str, count: int, jobs: int) -> None:
    job = prepare(name, load(find("fit", name), FitRecord), Settings())
    problem = replace(job.problem(job.folds[0]), insertions=job.folds[0].tune[:count])
    problem.jacobian(0.5 * (problem.lower + problem.upper))  # compiles
    began = time.perf_counter(), time.process_time()
    fit = minimize(problem, job.recipe, stream(job.recipe.seed, "verdict"), Watch(jobs=jobs))
    between = time.perf_counter(), time.process_time()
    examination = examine(problem, fit, jobs)
    ended = time.perf_counter(), time.process_time()
    took = [(b[0] - a[0], b[1] - a[1]) for a, b in ((began, between), (between, ended))]
    print(f"{len(problem.insertions)} insertions, {len(fit.starts)} starts, {jobs} threads")
    searched = f"{fit.evaluations} evaluations, {fit.gradients} of them with derivatives"
    print(f"fit:      {searched}, {said(took[0])}")
    print(f"profiles: {examination.evaluations} Jacobians, {said(took[1])}")
    for one in examination.parameters:
        profile = one.profile
        counts = f"{len(profile.at):3d} points, {profile.evaluations:4d} Jacobians"
        print(f"  {one.name:10s} {counts}, ends {' and '.join(profile.ends)}")


def said(took: tuple[float, float]) -> str:
    return f"{took[0]:.1f} s, {took[1]:.1f} s of processor"


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
