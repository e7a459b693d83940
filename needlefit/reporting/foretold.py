"""How well held-out needles were foretold: the table of counts and scores."""

import pandas as pd

from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.names import medium_name
from needlefit.reporting.numbers import fixed
from needlefit.validation.results import Results

_NOTES = (
    "Tips and points that fell into the interval foretold for them; of right predictions half and 95 %. CRPS "
    "is the mean absolute error of a sure prediction, less what stating doubt gains; smaller is better.",
    "Foretold are parameters, depths of layers and tip, pose and points as the dataset states their errors, "
    "through the layers of the planned path. What the model misses is not.",
)
_SOURCES = {"posterior": "the sampled posterior", "laplace": "a Gaussian about the fit"}


def foretold_layout(results: Results) -> Display:
    """Return one row per medium and number of layers, over all folds."""
    rows = []
    for (medium, layers), group in results.predictive.groupby(["medium", "layers"], sort=False):
        tips = (f"{int(group[f'tip_in_{level}'].sum())} of {len(group)}" for level in (50, 95))
        points = (f"{100 * group[f'shape_in_{level}'].mean():.0f} %" for level in (50, 95))
        scores = (fixed(group[f"{what}_crps_mm"].mean(), 3) for what in ("tip", "shape"))
        rows.append((medium_name(str(medium)), str(layers), *tips, *points, *scores))
    columns = (
        *(text("Held out"), Column("Layers")),
        *(Column("Tips in", "50 %"), Column("Tips in", "95 %")),
        *(Column("Points in", "50 %"), Column("Points in", "95 %")),
        *(Column("Tip CRPS", "mm"), Column("Shape CRPS", "mm")),
    )
    said = " and ".join(_SOURCES[str(source)] for source in pd.unique(results.predictive["from"]))
    return Display(
        "foretold", f"How well held-out needles were foretold, by {said}.", columns, tuple(rows), notes=_NOTES
    )
