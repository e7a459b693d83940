"""Tables and figure of curvatures: the readings of every needle."""

import pandas as pd

from needlefit.datasets.insertion import Insertion
from needlefit.geometry.curves import select_compared
from needlefit.inference.identifiability.directions import NORMAL_95_HALF_WIDTH_SD
from needlefit.inference.likelihood.compared_points import Curve
from needlefit.inference.likelihood.observations.curvature import require_curvature, surround_sensors
from needlefit.reporting.figures import Drawing
from needlefit.reporting.table_files import Row
from needlefit.studies.job import Job
from needlefit.studies.observations import StudiedObservation
from needlefit.studies.prediction_scores import tabulate_sensors
from needlefit.studies.run import FitFrames, Run


def draw_sensors(run: Run, role: str) -> dict[str, Drawing]:
    """Return the readings of all needles, toward +y and +z of C, and what was predicted of them."""
    sensors = FitFrames.of(run).curvature
    frame = sensors[["insertion", "direction", "s_mm"]].assign(
        measured=1e3 * sensors["kappa_1_per_mm"],
        predicted=1e3 * sensors["kappa_predicted_1_per_mm"],
        sd=1e3 * sensors["kappa_sd_1_per_mm"],
        origin=run.origin,
    )
    options = {"x": "s_mm", "x_label": "from the entry (mm)", "y_label": "curvature (1/m)", "height": 1.5}
    return {"sensors": Drawing("forms.readings", frame, options, _add_ends)} if len(frame) else {}


def _add_ends(sensors: pd.DataFrame) -> pd.DataFrame:
    """Return readings with their intervals, and with needle and direction as panels."""
    half, middle = NORMAL_95_HALF_WIDTH_SD * sensors["sd"], sensors["predicted"]
    panels = sensors["insertion"] + sensors["direction"].map({"y": "", "z": ", z"})
    return sensors.assign(panel=panels, low=middle - half, high=middle + half)


def check_sensors(job: Job) -> None:
    """Raise DataError where a recipe fits to curvatures, and an insertion has none."""
    if job.recipe.likelihood.measurement == "curvature":
        for insertion in (insertion for fold in job.folds for insertion in fold.tune):
            require_curvature(insertion)


def describe_sensors(job: Job, insertion: Insertion, curve: Curve) -> dict[str, list[Row]]:
    """Return the curvatures of a needle at its sensors, beside their readings."""
    about = curve(surround_sensors(insertion))[None]
    return {"curvature": [*tabulate_sensors(insertion, select_compared(about, job.dataset.compared))]}


CURVATURE = StudiedObservation(
    "curvature", draw_sensors, describe_fitted=describe_sensors, check=check_sensors
)
