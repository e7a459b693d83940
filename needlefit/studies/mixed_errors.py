"""Errors in units of the noise, of insertions that were measured by different things.

A verdict on needles of which some have shapes, some tips, tracks or curvatures, or on needles with several of
these, is on what each of them holds: the mean of its errors by the metrics of verdicts, each divided by its
noise floor.
"""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from needlefit.metrics import OVER_NOISE, TE, TRACK_RMS, verdict_metrics
from needlefit.studies.prediction_scores import CRPS_OVER_NOISE, PREDICTED


def add_errors_over_noise(frames: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Return the frames of a run, with errors and CRPS over the noise of roles whose insertions differ."""
    errors, predictive = (frames[name] for name in ("errors", "predictive"))
    metrics = [
        metric.name
        for metric in verdict_metrics()
        if metric.name in errors and f"floor_{metric.name}" in errors
    ]
    held = errors[metrics].notna()
    if {TRACK_RMS.name, TE.name} <= {*metrics}:
        held[TE.name] &= ~held[TRACK_RMS.name]  # the tip of a track is one of its readings
    kinds = (held @ 2 ** np.arange(len(metrics))).groupby(errors["role"]).transform("nunique")
    mixed = (kinds > 1) | (held.sum(axis=1) > 1)
    if not mixed.any():
        return {**frames}
    floors = errors[[f"floor_{name}" for name in metrics]].set_axis(metrics, axis=1)
    over = (errors[metrics] / floors).where(held).mean(axis=1).where(mixed)
    tested = floors.where(held)[mixed & (errors["role"] == "validate")].groupby(errors["insertion"]).first()
    parts = [
        predictive[column] / predictive["insertion"].map(tested[name])
        for name in metrics
        if (column := PREDICTED[name].crps) in predictive
    ]
    crps = pd.concat(parts, axis=1).mean(axis=1) if parts else float("nan")
    errors = errors.assign(**{OVER_NOISE.name: over, f"floor_{OVER_NOISE.name}": over.notna().astype(float)})
    return {**frames, "errors": errors, "predictive": predictive.assign(**{CRPS_OVER_NOISE: crps})}
