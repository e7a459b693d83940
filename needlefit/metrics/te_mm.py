"""Tip error (TE)."""

from needlefit.metrics import Metric

TE = Metric(
    "te_mm",
    "TE",
    "mm",
    "Tip error (TE): distance between the simulated and the measured tip.",
    compute=lambda curves: curves.tip_error,
    headline=True,
    order=40,
)
