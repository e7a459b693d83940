"""What the viewer shows of one name of the command line: a scene, a recording, or a measured insertion."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from needlefit.mechanics.needle import DEFAULT_DIAMETER_MM
from needlefit.planning.steerable_scene import SteerableScene
from needlefit.project.result_warnings import ResultWarning

if TYPE_CHECKING:
    from needlefit.studies.answer import RunFault
    from needlefit.viewer.overlays import MeasuredOverlay


@dataclass(frozen=True, kw_only=True)
class ViewedScene(SteerableScene):
    """Everything the viewer needs to show one name of the command line."""

    title: str
    note: str  #: where the parameters come from, and what cannot be shown and why; sentences
    origin_mark: str = ""  #: that its data were not measured
    measured: "MeasuredOverlay | None" = None
    #: what they are for: a specimen that was not fitted, with the spread between specimens, or one that was
    specimen: Literal["new", "same", ""] = ""
    fitted_depths: tuple[float, ...] = ()  #: of the insertions that a run has fitted, mm
    fitted_directions: int = 2  #: how many deflections a run has fitted, along y, and z
    warnings: tuple[ResultWarning, ...] = ()  #: what is suspicious in the dataset or the run that it is from
    #: returns the verdict of the run that it is from, with the checks that failed; no page waits for it
    recall: Callable[[], str] = str
    faults: "tuple[RunFault, ...]" = ()  #: why the run that it shows is not to be trusted

    @property
    def diameter(self) -> float:
        """Diameter at which the needle is drawn, mm."""
        return self.record.needle.outer_diameter_mm or DEFAULT_DIAMETER_MM
