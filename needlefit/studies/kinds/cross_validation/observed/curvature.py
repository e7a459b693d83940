"""Figure of curvatures: the readings of every needle."""

from needlefit.reporting.figures import Drawing
from needlefit.studies.fit_frames import FitFrames
from needlefit.studies.kinds.cross_validation.observed import ObservationFigures
from needlefit.studies.run import Run


def draw_sensors(run: Run, role: str) -> dict[str, Drawing]:
    """Return the readings of all needles, toward +y and +z of C, and what was predicted of them."""
    sensors = FitFrames.of(run).curvature
    frame = sensors[["insertion", "direction", "s_mm"]].assign(
        measured=1e3 * sensors["kappa_1_per_mm"],
        predicted=1e3 * sensors["kappa_predicted_1_per_mm"],
        sd=1e3 * sensors["kappa_sd_1_per_mm"],
        origin=run.origin,
    )
    return {"sensors": Drawing("curvature", frame)} if len(frame) else {}


CURVATURE = ObservationFigures("curvature", draw_sensors)
