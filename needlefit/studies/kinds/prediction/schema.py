"""The study file of a prediction, or the options of `needlefit predict`."""

from typing import Literal

from needlefit.schemas.analyses import TargetRecord
from needlefit.schemas.scene import SceneRecord


class PredictionRecord(TargetRecord):
    """`kind = "prediction"`: the predicted needle of a planned insertion."""

    kind: Literal["prediction"]
    scene: SceneRecord
    """The planned insertion: the keys of a scene."""
    scene_name: str = "scene"
    """Its name in tables and figures."""
    posterior: str | None = None
    """Folder of a sampled run of `target`; without it, a fit is made."""
    specimen: Literal["new", "same"] | None = None
    """Whether the insertion goes into a specimen that was not fitted ("new") or one that was ("same");
    without it, a new one, with the spread between specimens unless `specimens` of the target leaves that
    out."""
