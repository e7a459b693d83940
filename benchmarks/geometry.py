"""How well the model predicts measured shapes of a hole left out, by law of advance and by geometry: mean
in-plane errors, and how many tips and whole shapes the predicted 50 % and 95 % intervals cover.

Two geometries turn the slope u' of the solved beam into points. "rotation": u' is the rotation of the section
and the points are the integrals of cos u' and sin u' (`docs/model.md`). "tangent": u' is dy/dx and the points
are the integral of cos(atan u') and u; the needle is then longer than its arc length. Every fit is repeated
with each of them. Intervals are of the posterior alone ("plain"), and with the spread between specimens
("others"), as in `needlefit validate stereo_insertions`.

    NEEDLEFIT_REAL_DATA=... python benchmarks/geometry.py [--starts 2] [--errors-only]
        [--geometry tangent] [--fit stereo_tangent] [--correlation matern32]
"""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.interpolate import CubicHermiteSpline
from scipy.stats import t as student

from needlefit.arrays import Floats
from needlefit.inference import compared_points
from needlefit.inference.predict import estimate_proportion
from needlefit.mechanics.batch import Jacobian, Jacobians, NeedleShapes
from needlefit.mechanics.shape import NeedleShape
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.study import FitRecord
from needlefit.studies.held_out_predictions import Specimens, find_fit, fit_posterior, tabulate_held_out
from needlefit.studies.job import Settings, leave_out, prepare
from needlefit.studies.score import Scorer, model_predictor

GEOMETRIES = ("rotation", "tangent")
FITS = ("stereo_tangent", "stereo_path_angle")
NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)
STEP = 1e-5  # of the difference quotients, in units of the parameter


def draw_by_tangent(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    """Return the points (K, 2) at beam coordinates s (K,), u' read as dy/dx."""
    deflection = CubicHermiteSpline(x, u, slope)
    tangent = deflection.derivative()

    def advance(start: Floats, end: Floats) -> Floats:
        half = 0.5 * (end - start)[:, None]
        within = tangent(start[:, None] + half * (1 + NODES))
        return (half * WEIGHTS / np.sqrt(1 + within**2)).sum(axis=1)

    reached = x[0] + np.concatenate([[0.0], np.cumsum(advance(x[:-1], x[1:]))])
    element = np.clip(np.searchsorted(x, s) - 1, 0, len(x) - 2)
    return np.column_stack([reached[element] + advance(x[element], s), deflection(s)])


def compute_positions(shape: NeedleShape, s: Floats) -> Floats:
    """Stand in for the function of `compared_points` of this name."""
    return draw_by_tangent(shape.x, shape.u, shape.slope, s)


def compute_batch_positions(shapes: NeedleShapes, s: Floats) -> Floats:
    """Stand in for the function of `compared_points` of this name."""
    rows = zip(shapes.x, shapes.u, shapes.slope, shapes.converged, strict=True)
    return np.array(
        [draw_by_tangent(*row[:3], s) if row[3] else np.full((len(s), 2), np.nan) for row in rows]
    )


def differentiate_batch_positions(shapes: NeedleShapes, jacobians: Jacobians, s: Floats) -> Floats:
    """Stand in for the function of `compared_points` of this name."""
    nothing = np.full((len(s), 2, len(jacobians.names)), np.nan)
    rows = enumerate(shapes.converged)
    return np.array([_differentiate(shapes[i], jacobians[i], s) if good else nothing for i, good in rows])


def _differentiate(shape: NeedleShape, jacobian: Jacobian, s: Floats) -> Floats:
    """Return the derivatives (K, 2, P) of the points by difference quotients."""

    def move(column: int, by: float) -> Floats:
        parts = ((shape.x, jacobian.x), (shape.u, jacobian.u), (shape.slope, jacobian.slope))
        return draw_by_tangent(*(part + by * moved[:, column] for part, moved in parts), s)

    columns = range(jacobian.u.shape[1])
    sizes = [STEP / max(1e-9, float(np.abs(jacobian.u[:, p]).max())) for p in columns]
    return np.stack(
        [(move(p, h) - move(p, -h)) / (2 * h) for p, h in zip(columns, sizes, strict=True)], axis=-1
    )


@contextmanager
def geometry(name: str) -> Iterator[None]:
    """Let the inference read points by one of the two geometries."""
    stand_ins = (
        (compute_positions, compute_batch_positions, differentiate_batch_positions)
        if name == "tangent"
        else ()
    )
    before = {one.__name__: getattr(compared_points, one.__name__) for one in stand_ins}
    for one in stand_ins:
        setattr(compared_points, one.__name__, one)
    try:
        yield
    finally:
        for key, one in before.items():
            setattr(compared_points, key, one)


def score_holes(
    name: str, starts: int, coverage: bool, correlation: str | None = None
) -> tuple[pd.Series, pd.DataFrame]:
    """Return the mean in-plane error, mm, of each hole left out, and a row for each predicted shape.

    `correlation` is that of the measurement's errors along the needle, by default the dataset's.
    """
    job = prepare(name, load(find_file("fit", name), FitRecord), Settings())
    noise = replace(job.dataset.noise, **({"correlation": correlation} if correlation else {}))
    job = replace(job, recipe=job.recipe.model_copy(update={"starts": starts}))
    job = replace(job, dataset=replace(job.dataset, noise=noise))
    found, predicted = {}, []
    for fold in leave_out(job.folds[0].tune, "specimen"):
        if coverage:
            learned = fit_posterior(job, job.problem(fold), (fold.name,), Settings())
            fit, draws = learned.fit, learned.draws
            news = {"plain": None, "others": Specimens(job, fold, learned.draws)}
            predicted += [
                {**row, "treatment": treatment}
                for treatment, new in news.items()
                for row in tabulate_held_out(job, fold, draws, new)
            ]
        else:
            fit = find_fit(job, job.problem(fold), (fold.name,), Settings())
        scorer = Scorer(
            job.dataset, job.record.layer_count_rule, {one.id: job.floor(one) for one in fold.validate}
        )
        predictor = model_predictor(fit.values, job.medium, job.dataset)
        rows = [row for one in fold.validate for row in scorer.score({}, one, predictor)[0]]
        found[fold.name] = float(np.mean([row["ipe_mean_mm"] for row in rows]))
    return pd.Series(found), pd.DataFrame(predicted)


def print_coverage(name: str, which: str, predicted: pd.DataFrame) -> None:
    """Print a row for each treatment of specimens: counts, with 95 % intervals of the share over holes."""
    for treatment, rows in predicted.groupby("treatment", sort=False):
        cells = []
        for what in ("tip", "shape"):
            for level in (50, 95):
                share = estimate_proportion(rows[f"{what}_in_{level}"].tolist(), rows["specimen"].tolist())
                ends = f"{100 * share.low:.0f} to {100 * share.high:.0f} %"
                cells.append(f"{what} {level}: {share.hits} of {share.trials} ({ends})")
        widths = rows["tip_95_high_mm"] - rows["tip_95_low_mm"]
        score = f"CRPS tip {rows['tip_crps_mm'].mean():.3f}, shape {rows['shape_crps_mm'].mean():.3f}"
        print(name, which, treatment, *cells, score, f"width {widths.median():.2f}", sep=" | ", flush=True)


def main() -> None:
    """Print a row per law of advance and geometry; differences to the first geometry are paired by hole."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--starts", type=int, default=2)
    parser.add_argument("--errors-only", action="store_true", help="without coverage")
    parser.add_argument("--geometry", choices=GEOMETRIES, help="default: both")
    parser.add_argument("--fit", choices=FITS, help="default: both")
    parser.add_argument("--correlation", choices=("exponential", "matern32"), help="default: the dataset's")
    given = parser.parse_args()
    geometries = (given.geometry,) if given.geometry else GEOMETRIES
    print("advance | geometry | mean in-plane error (mm) | minus that of the first (um), 95 % | by hole (mm)")
    for name in (given.fit,) if given.fit else FITS:
        errors = {}
        for which in geometries:
            with geometry(which):
                errors[which], predicted = score_holes(
                    name, given.starts, not given.errors_only, given.correlation
                )
            gap = 1e3 * (errors[which] - errors[geometries[0]])
            half = student.ppf(0.975, len(gap) - 1) * gap.sem()
            difference = f"{gap.mean():.1f} ({gap.mean() - half:.1f} to {gap.mean() + half:.1f})"
            holes = " ".join(f"{one:.4f}" for one in errors[which])
            if len(predicted):
                print_coverage(name, which, predicted)
            print(name, which, f"{errors[which].mean():.4f}", difference, holes, sep=" | ", flush=True)


if __name__ == "__main__":
    main()
