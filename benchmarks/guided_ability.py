"""Whether the model can follow a moved guide at all: fitted to the guided runs, no predictions.

For each medium of `guided_tips` the model, a straight line and a parabola are fitted to the guided runs, each
run with its own shift and slope; printed is what remains of all readings (root mean square, mm).

    NEEDLEFIT_REAL_DATA=... python benchmarks/guided_ability.py [--starts 8] [MEDIUM ...]
"""

import argparse

import numpy as np

from needlefit.datasets.read import read
from needlefit.datasets.select import select_insertions
from needlefit.inference.baselines import list_baselines
from needlefit.inference.forward_model import simulate_deflections
from needlefit.inference.optimize import minimize
from needlefit.inference.parameters import Parameters, with_noise_scale
from needlefit.inference.problem import Problem
from needlefit.inference.track_predictions import TrackDraws, draw_baseline
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.study import SelectionRecord
from needlefit.studies.kinds.tracks import tabulate_tuned


def main() -> None:
    """Print a row per medium."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--starts", type=int, default=8)
    parser.add_argument("media", nargs="*", help="default: all")
    arguments = parser.parse_args()
    starts, names = arguments.starts, arguments.media
    dataset = read(find_file("dataset", "guided_tips"))
    medium = load(find_file("medium", "gel_wax"), MediumRecord)
    recipe = load(find_file("recipe", "tracks"), RecipeRecord).model_copy(update={"starts": starts})
    parameters = with_noise_scale(Parameters.from_record(medium))
    print("medium | runs | straight line | parabola | model | at")
    for name in names or dataset.media:
        runs = select_insertions(dataset, SelectionRecord(medium=name, guided=True))
        met = [n for n in parameters.free if not n.startswith("mu") or int(n[2:-3]) in runs[0].sequence]
        asked = parameters.with_only(met, dict.fromkeys(parameters.free, 1.0))  # a layer not met has no say
        problem = Problem(dataset, runs, medium, asked, recipe.weights)
        left = [
            _left(problem, draw_baseline(one, problem.density.observations, (), 100, _rng()))
            for one in list_baselines()
            if one.track_basis
        ]
        fit = minimize(problem, recipe, _rng())
        tips = simulate_deflections([fit.values], medium, dataset.needle, runs, [run.depths for run in runs])
        left.append(_left(problem, TrackDraws(tips, (), np.ones(1))))
        at = ", ".join(f"{key} {fit.values[key]:.3g}" for key in problem.names)
        print(name, len(runs), *(f"{one:.3f}" for one in left), at, sep=" | ", flush=True)


def _left(problem: Problem, drawn: TrackDraws) -> float:
    rows = tabulate_tuned(problem.density.observations, drawn)
    return float(np.sqrt(np.mean([row["aligned_rms_mm"] ** 2 for row in rows])))


def _rng() -> np.random.Generator:
    return np.random.default_rng(1)


if __name__ == "__main__":
    main()
