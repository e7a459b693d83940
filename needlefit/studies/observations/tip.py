"""Figure of tips alone: deflections over depth."""

import numpy as np
import pandas as pd

from needlefit.reporting.figures import Drawing
from needlefit.reporting.labels import medium_name
from needlefit.schemas.run_metadata import FitMetadata
from needlefit.studies.observations import StudiedObservation
from needlefit.studies.run import FitFrames, Run
from needlefit.studies.scored_groups import find_bevel_sides


def draw_tips(run: Run, role: str) -> dict[str, Drawing]:
    """Return the deflections of tips over depth, toward their bevels, and what was predicted of them."""
    frames = FitFrames.of(run)
    places = frames.shapes.groupby("insertion")["j"].max()
    stored = run.knows(FitMetadata).insertions
    names = [*places.index[places == 1], *(name for name, row in stored.items() if "tip" in row.observations)]
    errors = frames.select_errors(role=role, method=frames.method)
    errors = errors[errors["insertion"].isin(names)]  # of which there are entry and tip, or a tip by itself
    if errors.empty:
        return {}
    sides = errors["insertion"].map(find_bevel_sides(run)).to_numpy(dtype=float)
    predicted = frames.predictive.set_index("insertion").reindex(errors["insertion"])
    ends = predicted[["tip_95_low_mm", "tip_95_high_mm"]].to_numpy(dtype=float)
    low, high = np.sort(sides[:, None] * ends, axis=1).T
    frame = errors[["insertion", "medium", "depth_mm"]].assign(
        measured_mm=errors["deflection_mm"],
        predicted_mm=errors["predicted_deflection_mm"],
        low_mm=low,
        high_mm=high,
    )
    options = {"x": "depth_mm", "x_label": "depth (mm)", "y_label": "tip deflection (mm)", "height": 1.9}
    return {"tips": Drawing("forms.readings", frame, options, _name_panels)}


def _name_panels(tips: pd.DataFrame) -> pd.DataFrame:
    named = tips.rename(columns=lambda name: name.removesuffix("_mm") if name != "depth_mm" else name)
    return named.assign(panel=tips["medium"].map(medium_name))


TIP = StudiedObservation("tip", draw_tips)
