"""Score methods: the curve of every method against every measured one, as rows of the tables of `Results`."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.noise import NoiseFloor
from needlefit.datasets.select import count_layers, get_other_rule
from needlefit.geometry.compare import compare_curves
from needlefit.inference.compared_points import Curve, SimulatedCurve, compare_points, make_curve
from needlefit.inference.forward_model import predict
from needlefit.mechanics.shape import NeedleShape
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.study import LayerCountRule
from needlefit.validation.planned_insertions import planned_layers
from needlefit.validation.validity import ValidityCounts

Floats = NDArray[np.float64]
Row = dict[str, Any]

Predictor = Callable[[Insertion], Mapping[str, Curve | None]]
"""An insertion -> a curve by kind of boundaries ("measured", "planned"); None where the solve failed."""


def model_predictor(values: Mapping[str, float], medium: MediumRecord, dataset: Dataset) -> Predictor:
    """Return the method that simulates with given parameter values.

    Where the layers are surfaces it is scored twice: with the measured crossings, as the paper does,
    though they leak a held-out needle's outcome, and with the crossings of the planned needle.
    """

    def curves(insertion: Insertion) -> dict[str, Curve | None]:
        def at(boundaries: Floats | None, sequence: tuple[int, ...] | None) -> NeedleShape:
            return predict(values, medium, dataset.needle, insertion, boundaries, sequence)

        shapes: dict[str, NeedleShape | None] = {"measured": at(None, None)}
        if insertion.surfaces:
            planned = planned_layers(insertion, at)
            shapes["planned"] = None if planned is None else at(*planned)
        return {
            kind: make_curve(shape) if shape is not None and shape.converged else None
            for kind, shape in shapes.items()
        }

    return curves


def curve_predictor(curve: Callable[[Insertion], Curve]) -> Predictor:
    """Return the method of an empirical curve, which has no layers."""
    return lambda insertion: {"measured": curve(insertion)}


@dataclass(frozen=True)
class Scorer:
    """What scoring needs besides method and insertion.

    Attributes
    ----------
    dataset : Dataset
    reading : str
        Which count of layers holds for an insertion that ends at a boundary.
    floors : mapping
        The noise floor of every insertion, by id.
    counts : ValidityCounts
        Keeps the validity of every simulation that is scored.
    """

    dataset: Dataset
    layer_count_rule: LayerCountRule
    floors: Mapping[str, NoiseFloor]
    counts: ValidityCounts = field(default_factory=ValidityCounts)

    def score(self, place: Row, insertion: Insertion, method: Predictor) -> tuple[list[Row], list[Row]]:
        """Return the rows of `errors` and of `shapes`; `place` has fold, role and method."""
        errors, shapes = [], []
        for boundaries, curve in method(insertion).items():
            where = {**place, "insertion": insertion.id, "boundaries": boundaries}
            row = {**where, **self._about(insertion)}
            if curve is None:
                errors.append({**row, **_FAILED_ERRORS})
                continue
            if isinstance(curve, SimulatedCurve):
                self.counts.score(where, curve.shape.validity)
            pose, drop = self.dataset.pose, self.dataset.drop_proximal
            simulated, measured = compare_points(pose, drop, insertion, curve)
            errors.append({**row, **self._errors(insertion, simulated, measured)})
            shapes += _shape_rows(where, simulated, measured)
        return errors, shapes

    def _about(self, insertion: Insertion) -> Row:
        floor = {f"floor_{name}": value for name, value in asdict(self.floors[insertion.id]).items()}
        return {
            "medium": insertion.medium,
            "specimen": insertion.specimen,
            "layers": count_layers(insertion, self.layer_count_rule),
            "layers_other": count_layers(insertion, get_other_rule(self.layer_count_rule)),
            "depth_mm": insertion.depth,
            "comparison": "world" if self.dataset.pose == "known" else "aligned",
            **floor,
        }

    def _errors(self, insertion: Insertion, simulated: Floats, measured: Floats) -> Row:
        e = compare_curves(simulated, measured)
        side = insertion.side
        floor = self.floors[insertion.id].te_mm
        return {
            "median_err_mm": e.median,
            "ipe_mean_mm": e.mean,
            "ipe_std_mm": e.std,
            "ipe_max_mm": e.maximum,
            "te_mm": e.te,
            "edp_percent": e.edp,
            "deflection_mm": side * e.deflection,
            "predicted_deflection_mm": side * float(simulated[-1, 1] - simulated[0, 1]),
            "edp_flagged": bool(abs(e.deflection) < floor),  # never where no floor is stated (NaN)
            "converged": True,
        }


_FAILED_ERRORS = {
    **dict.fromkeys(
        ("median_err_mm", "ipe_mean_mm", "ipe_std_mm", "ipe_max_mm", "te_mm", "edp_percent"), math.inf
    ),
    "deflection_mm": math.nan,
    "predicted_deflection_mm": math.nan,
    "edp_flagged": False,
    "converged": False,
}


def _shape_rows(where: Row, simulated: Floats, measured: Floats) -> list[Row]:
    return [
        {
            **where,
            "j": j,
            "measured_x_mm": float(m[0]),
            "measured_y_mm": float(m[1]),
            "simulated_x_mm": float(s[0]),
            "simulated_y_mm": float(s[1]),
        }
        for j, (s, m) in enumerate(zip(simulated, measured, strict=True))
    ]
