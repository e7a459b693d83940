"""The needle of a planned insertion for all draws of the parameters, its intervals and bands."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, split_boundary_sd
from needlefit.errors import ModelError
from needlefit.inference.compared_points import draw_rolls, turn_about_x
from needlefit.inference.curve_bands import find_bands
from needlefit.inference.draw_simulation import draw_entry_errors, simulate_scene_draws, vary_bevels
from needlefit.inference.point_prediction import PointPrediction, choose_point
from needlefit.inference.predict import INTERVAL_PROBABILITIES, estimate_end_errors
from needlefit.mechanics.scene import Scene
from needlefit.project.random_streams import random_stream
from needlefit.studies.fold_draws import Specimens

FORECAST_POINTS = 101  #: points of a predicted needle, from entry to tip
NEAR_DRAWS = 20  #: draws of which the one nearest to the median is chosen

#: in the names of columns: along y, and z
AXES = ("", "z_")


@dataclass(frozen=True)
class Forecast:
    """A predicted needle in the scene's constraint frame, with its uncertainty."""

    s: Floats  #: (K,), arc length from the entry, mm
    needle: Floats  #: (K, 3), the predicted needle, mm
    across: Floats  #: (B, K, 1), in space (B, K, 2): y, and z, of each draw that has a solution, mm
    failed: int  #: draws of which the solve failed; they are left out
    outside: int  #: draws whose needle is outside what the model assumes; they are kept
    point: PointPrediction  #: which needle is predicted
    mode: Mapping[str, float]  #: the parameters of the posterior mode
    nearest: Mapping[str, float] | None  #: of the draw whose tip is nearest to a median
    sets: Sequence[Mapping[str, float]]  #: parameters of all draws, each with a bevel of its own


def tabulate_forecast(forecast: Forecast) -> pd.DataFrame:
    """Return one row per station, mm: s and x, then y, in space z, its intervals and bands."""
    columns = {"s_mm": forecast.s, "x_mm": forecast.needle[:, 0]}
    count, points, directions = forecast.across.shape
    bands = find_bands(forecast.across.transpose(0, 2, 1).reshape(count, -1))  # over y and z together
    for n, axis in enumerate(AXES[:directions]):
        columns[f"needle_{axis}predicted_mm"] = forecast.needle[:, 1 + n]
        for level in INTERVAL_PROBABILITIES:
            pointwise = np.quantile(forecast.across[..., n], [(1 - level) / 2, (1 + level) / 2], axis=0)
            whole = (end.reshape(directions, points)[n] for end in bands.ends(level))
            errors = estimate_end_errors(forecast.across[..., n], level)
            for part, unit, ends in (
                ("needle", "mm", pointwise),
                ("needle", "error_mm", errors),
                ("band", "mm", whole),
            ):
                named = (f"{part}_{axis}{100 * level:.0f}_{end}_{unit}" for end in ("low", "high"))
                columns |= dict(zip(named, ends, strict=True))
    return pd.DataFrame(columns)


def forecast(scene: Scene, specimens: Specimens, into: Insertion | None) -> Forecast:
    """Predict the needle of a planned insertion.

    The scene is under the rules of the fit (`make_scene`); draws replace its moduli and bevel offset: layer n
    of the scene is layer n of the medium. With each draw a bevel of this insertion and the depths of layers
    and tip are drawn too, in space also the roll, as they err in a typical insertion of the dataset. The
    specimen is that of the insertion `into`, or, with None, one that is not in the dataset. Where it has no
    draws of its own, those of all insertions together stand in.

    Raises ModelError if no draw can be solved, or the mode cannot.
    """
    job, draws, mode = specimens.job, specimens.draws_in(into), specimens.mode_in(into)
    thetas = draws.thetas if len(draws.thetas) else specimens.draws.thetas
    assert mode is not None
    rng = random_stream(job.recipe.seed, job.name, "forecast")
    s = np.linspace(0.0, scene.depth, FORECAST_POINTS)
    sets = vary_bevels([job.parameters.values(theta) for theta in thetas], specimens.bevel_sd_in(into), rng)
    typical = [
        (insertion.depth_sd, np.hypot(*split_boundary_sd(insertion))) for insertion in job.dataset.insertions
    ]
    entry_sd, boundary_sd = np.sqrt(np.mean(np.square(typical), axis=0))
    deep = draw_entry_errors(entry_sd, len(sets), rng)
    wrong = boundary_sd * rng.standard_normal((len(sets), scene.tissue.layers - 1))
    drawn = simulate_scene_draws(sets, job.medium, scene, s, deep, wrong)
    points = drawn.points[drawn.solved]  # (B, K, 3)

    def simulate(values: Mapping[str, float]) -> Floats:
        """Return the needle (K, 3) of one set of values at the depths as they are stated."""
        exact = np.zeros((1, scene.tissue.layers))
        (simulated,) = simulate_scene_draws([values], job.medium, scene, s, exact[:, 0], exact[:, 1:]).points
        return simulated

    needle = simulate(job.parameters.values(mode))
    if not (len(points) and np.isfinite(needle).all()):
        raise ModelError(
            f"{len(points)} of {len(thetas)} draws of the parameters can be solved for this scene, and "
            f"{'not ' * bool(len(points))}their mode",
            fix="look at `needlefit simulate` of the scene; lessen its depth or its deflection",
        )
    outside = int(np.sum(~drawn.valid[drawn.solved]))
    directions = max(job.dataset.directions, 1 + int(points[..., 2].any()))
    roll_sd = math.sqrt(np.mean([insertion.roll_sd**2 for insertion in job.dataset.insertions]))
    points = turn_about_x(points, draw_rolls(roll_sd, directions, len(points), rng))
    compared, point = slice(1, 1 + directions), PointPrediction()
    if not draws.faults:
        problem = job.problem(specimens.fold)
        point = choose_point(
            problem, mode, points[..., compared], lambda theta: simulate(problem.values(theta))[:, compared]
        )
    needle, nearest = point.take(needle, points), None
    if point.is_median:
        away = np.linalg.norm(points[:, -1] - needle[-1], axis=1)
        near = np.flatnonzero(drawn.solved)[np.argsort(away)[:NEAR_DRAWS]]
        nearest = min(
            (sets[n] for n in near), key=lambda values: np.linalg.norm(simulate(values)[-1] - needle[-1])
        )
    return Forecast(
        s,
        needle,
        points[..., compared],
        failed=len(thetas) - len(points),
        outside=outside,
        point=point,
        mode=job.parameters.values(mode),
        nearest=nearest,
        sets=sets,
    )
