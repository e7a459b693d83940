"""What the viewer shows of one name of the command line: a scene, a recording, or a measured insertion."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from needlefit.mechanics.needle import DEFAULT_DIAMETER_MM
from needlefit.planning.recording import make_head
from needlefit.project.result_warnings import ResultWarning
from needlefit.schemas.recording import PlacementRecord, RecordingRecord
from needlefit.schemas.scene import SceneRecord

if TYPE_CHECKING:
    from needlefit.inference.forward_model import ParameterDraws
    from needlefit.studies.answer import RunFault
    from needlefit.viewer.overlays import MeasuredOverlay


@dataclass(frozen=True)
class ViewedScene:
    """Everything the viewer needs to show one name of the command line."""

    name: str  #: opens it again
    title: str
    note: str  #: where the parameters come from, and what cannot be shown and why; sentences
    record: SceneRecord  #: the scene: needle, tissue and inputs
    #: depth of the first constraint point, mm, with which a `Session` ends as `simulate` and `predict` do
    first_cell: float
    #: the position of a measured needle; None for a scene, which contains its own
    placement: PlacementRecord | None = None
    origin_mark: str = ""  #: that its data were not measured
    measured: "MeasuredOverlay | None" = None
    spread: "ParameterDraws | None" = None  #: draws of the parameters, for the band of a fit and for plans
    #: what they are for: a specimen that was not fitted, with the spread between specimens, or one that was
    specimen: Literal["new", "same", ""] = ""
    fitted_depths: tuple[float, ...] = ()  #: of the insertions that a run has fitted, mm
    fitted_directions: int = 2  #: how many deflections a run has fitted, along y, and z
    #: insertions that can be shown instead: by name, with their titles
    choices: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[ResultWarning, ...] = ()  #: what is suspicious in the dataset or the run that it is from
    #: returns the verdict of the run that it is from, with the checks that failed; no page waits for it
    recall: Callable[[], str] = str
    faults: "tuple[RunFault, ...]" = ()  #: why the run that it shows is not to be trusted

    @property
    def diameter(self) -> float:
        """Diameter at which the needle is drawn, mm."""
        return self.record.needle.outer_diameter_mm or DEFAULT_DIAMETER_MM

    def make_head(self) -> RecordingRecord:
        return make_head(self.name, self.first_cell, self.record, self.placement)
