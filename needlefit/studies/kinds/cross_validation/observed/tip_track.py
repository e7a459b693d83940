"""Figure of tip tracks that were held out: their readings over depth."""

from needlefit.reporting.figures import Drawing
from needlefit.studies.fit_frames import FitFrames
from needlefit.studies.kinds.cross_validation.observed import ObservationFigures
from needlefit.studies.run import Run


def draw_tracks(run: Run, role: str) -> dict[str, Drawing]:
    """Return every predicted run, the tip at each reading and the guide below it."""
    readings = FitFrames.of(run).readings
    return {"readings": Drawing("tip_track", readings)} if len(readings) else {}


TIP_TRACK = ObservationFigures("tip_track", draw_tracks)
