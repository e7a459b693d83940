"""Figures of points along the needle."""

from needlefit.reporting.figures import Drawing
from needlefit.studies import fit_figures
from needlefit.studies import scored_groups as scores
from needlefit.studies.fit_frames import FitFrames
from needlefit.studies.kinds.cross_validation.observed import ObservationFigures
from needlefit.studies.run import Run


def draw_needles(run: Run, role: str) -> dict[str, Drawing]:
    """Return the insertions with the smallest, middle and largest tip error, and all of them."""
    if FitFrames.of(run).select_curves(role, method="fitted").empty:
        return {}
    names = ("overlays", "overlays_above")[: scores.count_directions(run)]
    overlays = {name: fit_figures.draw_overlays(run, role, from_above=name != names[0]) for name in names}
    return {"insertions": fit_figures.draw_first_page(run, role), **overlays}


POINTS = ObservationFigures("points", draw_needles)
