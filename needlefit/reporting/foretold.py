"""How well held-out needles were foretold: the table of counts and scores."""

import pandas as pd

from needlefit.datasets.select import group_independent
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.names import medium_name
from needlefit.reporting.numbers import fixed
from needlefit.validation.proportions import Proportion, estimate_proportion
from needlefit.validation.results import Results

_NOTES = (
    "Tips that fell into the interval foretold for them, and shapes of which no point left the band foretold "
    "for them as a whole; of right predictions half and 95 %. In brackets the 95 % interval of that share, "
    "in which repeats in one specimen count as one trial where there are five specimens or more, and else as "
    "many; how specimens differ is then not in it. CRPS is the mean absolute error of a sure "
    "prediction, less what stating doubt gains; smaller is better.",
    "Foretold are parameters, depths of layers and tip, pose and points as the dataset states their errors, "
    "through the layers of the planned path. What the model misses is not.",
)
_SOURCES = {"posterior": "the sampled posterior", "importance": "draws of the posterior about the fit"}
TOLD = (
    *(Column(f"{what} in", f"{level} %") for what in ("Tips", "Shapes") for level in (50, 95)),
    *(Column("Tip CRPS", "mm"), Column("Shape CRPS", "mm")),
)
"""Heads of what became of predictions."""


def foretold_layout(results: Results) -> Display:
    """Return one row per medium and number of layers, over all folds."""
    rows = []
    for (medium, layers), group in results.predictive.groupby(["medium", "layers"], sort=False):
        rows.append((medium_name(str(medium)), str(layers), *told_cells(group)))
    columns = (text("Held out"), Column("Layers"), *TOLD)
    doubtful = int((~results.predictive["certified"].astype(bool)).sum())
    notes = (
        *_NOTES,
        *(
            (f"The draws behind {doubtful} of these needles are not certified: sample them (--sample).",)
            if doubtful
            else ()
        ),
    )
    said = " and ".join(_SOURCES[str(source)] for source in pd.unique(results.predictive["draw_source"]))
    return Display(
        "foretold", f"How well held-out needles were foretold, by {said}.", columns, tuple(rows), notes=notes
    )


def told_cells(told: pd.DataFrame) -> tuple[str, ...]:
    """Return the cells under `TOLD` of some needles: shares within their intervals, and mean scores."""
    together = group_independent(list(told["insertion"]), list(told["specimen"]))
    held = (f"{what}_in_{level}" for what in ("tip", "shape") for level in (50, 95))
    shares = (said_of(estimate_proportion(list(told[column]), together)) for column in held)
    scores = (fixed(told[f"{what}_crps_mm"].mean(), 3) for what in ("tip", "shape"))
    return (*shares, *scores)


def said_of(found: Proportion) -> str:
    """Return counts and the interval of their share: "9 of 10 (60–98 %)"."""
    return f"{found.hits} of {found.trials} ({100 * found.low:.0f}–{100 * found.high:.0f} %)"
