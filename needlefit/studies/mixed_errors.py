"""Errors in units of the noise, of insertions that were measured by different things.

A verdict on needles of which some have shapes, some tips, tracks or curvatures is on what each of them holds:
the error by the metric of its verdict, divided by its noise floor.
"""

from collections.abc import Mapping

import pandas as pd

from needlefit.metrics import OVER_NOISE, verdict_metrics
from needlefit.studies.prediction_scores import CRPS_OVER_NOISE, PREDICTED


def add_errors_over_noise(frames: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Return the frames of a run, with errors and CRPS over the noise of roles whose insertions differ."""
    errors, predictive = (frames[name] for name in ("errors", "predictive"))
    metrics = [
        metric.name
        for metric in verdict_metrics()
        if metric.name in errors and f"floor_{metric.name}" in errors
    ]
    is_known = errors[metrics].notna()
    metric = is_known.idxmax(axis=1).where(is_known.any(axis=1)) if len(errors) else pd.Series(dtype=object)
    mixed = metric.groupby(errors["role"]).transform("nunique") > 1
    if not mixed.any():
        return {**frames}
    over = pd.Series(float("nan"), errors.index)
    crps = pd.Series(float("nan"), predictive.index)
    for name in metrics:
        rows = errors[mixed & (metric == name)]
        over[rows.index] = rows[name] / rows[f"floor_{name}"]
        floors = rows[rows["role"] == "validate"].groupby("insertion")[f"floor_{name}"].first()
        floor = predictive["insertion"].map(floors)
        if (column := PREDICTED[name].crps) in predictive:
            crps = crps.fillna(predictive[column] / floor)
    errors = errors.assign(**{OVER_NOISE.name: over, f"floor_{OVER_NOISE.name}": over.notna().astype(float)})
    return {**frames, "errors": errors, "predictive": predictive.assign(**{CRPS_OVER_NOISE: crps})}
