"""Curvatures alone: the verdict is on their errors, and the readings of every needle are drawn."""

from dataclasses import replace

from needlefit.metrics import CURVATURE_RMS
from needlefit.reporting.figures import Drawing
from needlefit.studies.fit_frames import FitFrames
from needlefit.studies.kinds.cross_validation.observed.points import POINTS
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import find_score


def are_curvatures(run: Run) -> bool:
    """Return whether curvatures were read of every needle that is scored, and no place of it."""
    frames = FitFrames.of(run)
    return find_score(frames.select_errors(frames.role)) == CURVATURE_RMS.name


def draw_sensors(run: Run, role: str) -> dict[str, Drawing]:
    """Return the readings of all needles, toward +y and +z of C, and what was predicted of them."""
    found = FitFrames.of(run).curvature
    frame = found[["insertion", "direction", "s_mm"]].assign(
        measured=1e3 * found["kappa_1_per_mm"],
        predicted=1e3 * found["kappa_predicted_1_per_mm"],
        sd=1e3 * found["kappa_sd_1_per_mm"],
        origin=run.origin,
    )
    return {"sensors": Drawing("curvature", frame)} if len(frame) else {}


CURVATURE = replace(POINTS, name="curvature", holds=are_curvatures, figures=draw_sensors)
