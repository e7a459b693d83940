"""Predict a planned insertion from a fit: draws of its posterior, simulated in a scene.

The predicted needle is that of the posterior mode, or the predictive median (`choose_point`). Its bands come
from the draws of the parameters, of a bevel for each insertion, and of the depths of layers and tip; in a
specimen that was not tuned on the parameters differ (`Specimens`). They include neither model error nor
errors of measurement. Draws that are not certified have no bands.

What is known of the fit, by a run of it, stands first: its verdict and failed checks.
"""

from typing import Literal

from needlefit.schemas.run_metadata import PredictionMetadata
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import TargetRecord
from needlefit.studies.kind import StudyKind


class PredictionRecord(TargetRecord):
    """`kind = "prediction"`: the predicted needle of a planned insertion."""

    kind: Literal["prediction"]
    scene: SceneRecord
    """The planned insertion: the keys of a scene."""
    scene_name: str = "scene"
    """Its name in tables and figures."""
    posterior: str | None = None
    """Folder of a sampled run of `target`; without it, a fit is made."""
    specimen: str | None = None
    """Where the insertion goes: into a specimen that was not fitted ("new"), or one that was ("same"; of
    several that differ, its name); without it, a fitted one if `same_specimen` of the target says so, else a
    new one, with the spread between specimens unless `specimens` of the target leaves that out."""


#: kind of study that `needlefit predict` runs, or a study file
KIND = StudyKind("prediction", PredictionRecord, __name__, PredictionMetadata)
