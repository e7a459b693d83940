"""Score methods: the curve of every method against every measured one, as rows of the tables of `Run`."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from needlefit.datasets.insertion import Dataset, Insertion, InsertionPose, find_pose
from needlefit.datasets.noise import NoiseFloor, state_tip_errors
from needlefit.datasets.select import count_layers, name_holes, select_same_needle
from needlefit.geometry.curves import ComparedCurves
from needlefit.inference.baseline_fit import FittedBaseline, fit_baselines
from needlefit.inference.baselines import list_baselines
from needlefit.inference.fit import Fit
from needlefit.inference.forward_model import predict, with_planned_layers
from needlefit.inference.likelihood.compared_points import ComparedPoints, Curve, align_points
from needlefit.inference.likelihood.observations import (
    OBSERVATIONS,
    SimulatedCurve,
    list_comparisons,
    list_scored,
)
from needlefit.inference.problem import Problem
from needlefit.mechanics.needle import Needle
from needlefit.metrics import TE, compute_metrics, list_metrics
from needlefit.reporting.table_files import Row
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.study import LayerCountRule
from needlefit.studies.job import Job
from needlefit.studies.run import MODEL_METHODS

SCORE_KEYS = ("fold", "role", "insertion", "method", "boundaries")

#: an insertion -> a curve by kind of boundaries ("measured", "planned"); None where the solve failed
Predictor = Callable[[Insertion], Mapping[str, Curve | None]]


def model_predictor(
    values: Mapping[str, float], medium: MediumRecord, predicted: Mapping[str, Curve | None] | None = None
) -> Predictor:
    """Return the method that simulates with given parameter values.

    Where the layers are surfaces it is scored twice: with the measured crossings, as the paper does,
    though they leak a held-out needle's outcome, and with the crossings of the planned needle. Some of the
    latter may be `predicted` before, by insertion.
    """
    before = predicted or {}

    def curves(insertion: Insertion) -> dict[str, Curve | None]:
        found = {"measured": _simulate(values, medium, insertion)}
        if insertion.id in before:
            found["planned"] = before[insertion.id]
        elif insertion.surfaces:
            found["planned"] = predict_needle(values, medium, insertion)
        return found

    return curves


def _simulate(values: Mapping[str, float], medium: MediumRecord, insertion: Insertion) -> Curve | None:
    shape = predict(values, medium, insertion)
    return SimulatedCurve(shape, insertion) if shape.converged else None


def predict_needle(values: Mapping[str, float], medium: MediumRecord, insertion: Insertion) -> Curve | None:
    """Return the needle of given values through the layers that it meets itself; None without a solution."""
    met = with_planned_layers(insertion, values, medium)
    return None if met is None else _simulate(values, medium, met)


def curve_predictor(curve: Callable[[Insertion], Curve]) -> Predictor:
    """Return the method of an empirical curve, which has no layers."""
    return lambda insertion: {"measured": curve(insertion)}


def make_predictors(
    problem: Problem,
    fits: Mapping[str, Fit],
    hand_tuned: Mapping[str, float] | None,
    predicted: Mapping[str, Curve | None] | None = None,
) -> dict[str, Predictor]:
    """Return the fits, the paper's set, and the baseline curves.

    `predicted`: needles of the fit by insertion, through the layers that they meet, where they are known.
    """
    values = {name: fit.values for name, fit in fits.items()}
    if hand_tuned is not None:
        values["hand_tuned"] = hand_tuned
    models = {
        name: model_predictor(values[name], problem.medium, predicted if name == "fitted" else None)
        for name in MODEL_METHODS
        if name in values
    }

    @cache
    def fit(needle: Needle) -> Mapping[str, FittedBaseline]:
        """Return the curves of a needle by themselves, as needles bend differently."""
        return fit_baselines(problem.dataset, select_same_needle(problem.insertions, needle))

    def predict_by(name: str) -> Predictor:
        return curve_predictor(lambda insertion: fit(insertion.needle)[name].curve(insertion))

    curved = all(OBSERVATIONS[insertion.observation].is_curve for insertion in problem.insertions)
    baselines = [baseline.name for baseline in list_baselines() if curved or not baseline.of_curve]
    return models | {name: predict_by(name) for name in baselines}


#: comparisons of curves, by what is known of their poses
COMPARISONS: Mapping[InsertionPose, str] = {
    "known": "world",
    "direction": "shifted",
    "free": "aligned",
    "tracker": "aligned",
}


#: Of the table "errors": a row per fold, role ("tune", "validate"), insertion, method and boundaries
#: ("measured", as in the paper, or "planned"), with a column per metric and its noise floor. Our "prediction"
#: never uses measured layers. These columns are of the insertion; `layers` is by the study's rule.
#: `comparison` is "world", "shifted" across where the direction of the entry alone is known, or "aligned"
#: for shapes known only up to a rigid motion.
INSERTION_COLUMNS = ("medium", "hole", "specimen", "layers", "depth_mm", "comparison", "compared")
#: columns that are known of compared curves, and what stands there where the solve failed
FAILED: Row = {
    **dict.fromkeys(("deflection_mm", "predicted_deflection_mm"), math.nan),
    **dict.fromkeys(("tip_error_x_mm", "tip_error_y_mm", "tip_error_z_mm"), math.nan),
    **dict.fromkeys(("tip_across_sd_mm", "tip_registered_sd_mm"), math.nan),
    **{"edp_flagged": False, "converged": False},
}
ERROR_COLUMNS = (*SCORE_KEYS, *INSERTION_COLUMNS, *FAILED)


@dataclass(frozen=True)
class Scorer:
    """What scoring needs besides method and insertion."""

    dataset: Dataset
    layer_count_rule: LayerCountRule  #: which count holds for an insertion that ends at a boundary
    floors: Mapping[str, NoiseFloor]  #: the noise floor of every insertion, by id

    def score(self, place: Row, insertion: Insertion, method: Predictor) -> dict[str, list[Row]]:
        """Return the scores of a method on an insertion; `place` has fold, role and method.

        They are rows of the tables "errors" and "shapes", and what is "outside" what the model assumes.
        """
        errors, shapes, outside = list[Row](), list[Row](), list[Row]()
        for boundaries, curve in method(insertion).items():
            where = {**place, "insertion": insertion.id, "boundaries": boundaries}
            row = self.describe(where, insertion, self.floors[insertion.id])
            goals = list_comparisons(self.dataset, insertion)
            if curve is None:
                row |= {metric.name: math.inf for metric in list_metrics(*(goal.quantity for goal in goals))}
                errors.append(row | FAILED)
                continue
            if isinstance(curve, SimulatedCurve) and curve.shape.validity.faults:
                outside.append(where)
            errors.append(row | self.compute_errors(insertion, [goal.compare(curve) for goal in goals]))
            shapes += _list_shapes(where, goals, curve)
        return {"errors": errors, "shapes": shapes, "outside": outside}

    def describe(self, where: Row, insertion: Insertion, floors: NoiseFloor) -> Row:
        """Return the row of an insertion and a method before its errors."""
        about = (
            *(insertion.medium, self.holes.get(insertion.id, insertion.id), insertion.specimen),
            *(count_layers(insertion, self.layer_count_rule), insertion.depth),
            *(COMPARISONS[find_pose(self.dataset.pose, insertion)], self.dataset.compared),
        )
        row = where | dict(zip(INSERTION_COLUMNS, about, strict=True))
        row |= {f"floor_{name}": value for name, value in floors.items()}
        return row | {metric.name: math.nan for metric in list_metrics("places")}  # where none was measured

    def compute_errors(self, insertion: Insertion, curves: Sequence[ComparedCurves]) -> Row:
        """Return the errors of compared curves of an insertion, and the columns that are known of them."""
        row = Row()
        for curve in curves:  # the errors of a tip that was measured by itself replace those of a shape's
            row |= {name: error for name, error in compute_metrics(curve).items() if not math.isnan(error)}
        # the deflection, toward the bevel, is that of a tip, where one is known
        tip = next((curve for curve in reversed(curves) if curve.quantity == "places"), curves[0])
        deflections, off = np.full(2, math.nan), np.full(3, math.nan)
        if tip.quantity == "places":  # along z a tip that is compared in a plane misses by 0
            heights = np.array([points[:, 1] for points in (tip.measured, tip.simulated)])
            deflections = insertion.side * (heights[:, -1] - heights[:, 0])
            off = np.append(tip.simulated[-1] - tip.measured[-1], 0.0)[:3]
        parts = list_scored(self.dataset, insertion)
        measured = next((part for part in reversed(parts) if part.kind.has_tip), parts[0])
        sds = state_tip_errors(measured.dataset, measured.insertion)
        # a deflection below the noise floor; never where no floor is stated (NaN)
        flagged = tip.deflection < self.floors[insertion.id].get(TE.name, math.nan)
        values = (*deflections.tolist(), *off.tolist(), *sds, bool(flagged), True)
        return row | dict(zip(FAILED, values, strict=True))

    @cached_property
    def holes(self) -> Mapping[str, str]:
        """The name of the hole of each insertion, by id."""
        return name_holes(self.dataset)


def make_scorer(job: Job) -> Scorer:
    """Return what scores the insertions of a job."""
    floors = {insertion.id: job.floor(insertion) for insertion in job.insertions}
    return Scorer(job.dataset, job.record.layer_count_rule, floors)


def _list_shapes(where: Row, goals: Iterable[ComparedPoints], curve: Curve) -> Iterator[Row]:
    """Yield the columns of the places that are compared; rows of places take nine times the memory.

    Of curvatures there are none, beside a tip those of the shape.
    """
    names = "j", *(f"{which}_{axis}_mm" for which in ("measured", "simulated") for axis in "xyz")
    for goal in [goal for goal in goals if goal.quantity == "places"][:1]:
        simulated, measured = align_points(goal, curve)
        columns = np.arange(len(measured)), *measured.T, *simulated.T
        yield where | dict(zip(names, columns, strict=True))
