"""What the viewer shows of one name of the command line: a scene, a recording, or a measured insertion."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from needlefit.planning.steerable_scene import SteerableScene
from needlefit.project.result_warnings import ResultWarning

if TYPE_CHECKING:
    from needlefit.studies.run import Run


@dataclass(frozen=True, kw_only=True)
class ViewedScene(SteerableScene):
    """Everything the viewer needs to show one name of the command line."""

    title: str
    note: str  #: where the parameters come from, and what cannot be shown and why; sentences
    origin_mark: str = ""  #: that its data were not measured
    measured: Mapping[str, Any] | None = None  #: the measured needle as the page has it
    #: what they are for: a specimen that was not fitted, with the spread between specimens, or one that was
    specimen: Literal["new", "same", ""] = ""
    fitted_depths: tuple[float, ...] = ()  #: of the insertions that a run has fitted, mm
    fitted_directions: int = 2  #: how many deflections a run has fitted, along y, and z
    warnings: tuple[ResultWarning, ...] = ()  #: what is suspicious in the dataset or the run that it is from
    run: "Run | None" = None  #: that it is from
