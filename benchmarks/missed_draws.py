"""Whether draws by importance sampling leave out a part of the posterior where the truth lies.

Replicates of `needlefit calibrate STUDY` are drawn three times: about the peaks that the search finds, along
the profiles through the best of them too (as always), and about the true parameters besides. Printed is the
share of draws below the truth (PIT), of the combination that the design determines best, what the draws
are worth, Pareto's k and the processor time. Where the first draws cover the posterior, all shares are alike.

    python benchmarks/missed_draws.py study1 [--replicates 0,1,2] [--starts 16]
"""

import argparse
import time

import numpy as np

from needlefit.inference.identifiability.profile import minimize_squares
from needlefit.inference.optimize import minimize
from needlefit.inference.sampling.importance import Effort, find_modes, sample_about_modes
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import load
from needlefit.schemas.study import StudyRecord
from needlefit.studies.job import Job, Settings, prepare
from needlefit.studies.kinds.calibration import prepare_experiment, simulate_experiment


def compute_shares(job: Job, number: int, starts: int, direction: np.ndarray) -> list[str]:
    """Return share, effective draws and Pareto k: about peaks, along profiles, with the truth."""
    seed = job.recipe.seed
    simulated = simulate_experiment(job, random_stream(seed, job.name, "calibrate", number, "data"))
    problem = simulated.problem
    recipe = job.recipe.model_copy(update={"minimize": "posterior", "starts": starts})
    rng = random_stream(seed, job.name, "calibrate", number, "inference")
    peaks = find_modes(minimize(problem, recipe, rng), problem.upper - problem.lower)
    cells = []
    three = ((peaks, False), (peaks, True), (np.vstack([peaks, simulated.theta]), True))
    for centres, profiles in three:
        began = time.process_time()
        modes = [minimize_squares(problem, centre) for centre in centres]
        efforts = (Effort(profiles=profiles),)
        found = sample_about_modes(problem, modes, np.random.default_rng(number), efforts=efforts)
        spent = time.process_time() - began
        below = found.thetas @ direction < simulated.theta @ direction
        share = float(np.exp(found.log_weights[below]).sum())
        cells.append(f"{share:.3f} | {found.effective_sample_size:.0f} | {found.k:.2f} | {spent:.1f}")
    return cells


def main() -> None:
    """Print a row per replicate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("study")
    parser.add_argument("--replicates", default="0,1,2")
    parser.add_argument("--starts", type=int, default=16)
    arguments = parser.parse_args()
    name = arguments.study
    job = prepare(name, load(find_file("study", name), StudyRecord), Settings())
    direction = np.array(list(prepare_experiment(job).stiff.values()))
    ways = ("about peaks", "along profiles", "with the truth")
    print("replicate", *(f"{way}: PIT | draws worth | Pareto k | s" for way in ways), sep=" | ")
    for number in map(int, arguments.replicates.split(",")):
        cells = compute_shares(job, number, arguments.starts, direction)
        print(number, *cells, sep=" | ", flush=True)


if __name__ == "__main__":
    main()
