"""A scene for the viewer, with its overlays."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.inference.parameter_draws import ParameterDraws
from needlefit.project.result_warnings import ResultWarning
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.tracker import PlacementRecord
from needlefit.studies.needles_in_scan import DEFAULT_DIAMETER_MM
from needlefit.viewer.overlay.measured import MeasuredOverlay
from needlefit.viewer.overlay.slice import InsertionScan


@dataclass(frozen=True)
class ShownInsertion:
    """A measured insertion, and the parameters (Pa, mm) of the needle shown with it.

    `seed` is that of the draws of its noise floor, so that it is the one of studies.
    """

    dataset: Dataset
    insertion: Insertion
    medium: MediumRecord
    values: Mapping[str, float]
    seed: int


@dataclass(frozen=True)
class ViewedScene:
    """Everything the viewer needs to show one name of the command line.

    Attributes
    ----------
    name : str
        Opens it again.
    note : str
        Where the parameters come from, and what cannot be shown and why; sentences.
    record : SceneRecord
        The scene: needle, tissue and inputs.
    first_cell : float
        Depth of the first constraint point, mm, with which a `Session` ends as `simulate` and `predict` do.
    placement : PlacementRecord or None
        The position of a measured needle; None for a scene, which contains its own.
    synthetic : bool
        Whether it is about synthetic data.
    spread : ParameterDraws or None
        Draws of the parameters, for the band of a fit and for plans.
    specimen : "new", "same" or ""
        What they are for: a specimen that was not fitted, with the spread between specimens, or one that was.
    scanned : InsertionScan or None
        The scan in which the needle was measured.
    choices : tuple of str
        Insertions that can be shown instead.
    warnings : tuple of ResultWarning
        What is suspicious in the dataset or the run that it is from.
    shown : ShownInsertion or None
        The measured insertion with its dataset, to be fitted to.
    faults : tuple of str
        Why the run that it shows is not to be trusted.
    """

    name: str
    title: str
    note: str
    record: SceneRecord
    first_cell: float
    placement: PlacementRecord | None = None
    synthetic: bool = False
    measured: MeasuredOverlay | None = None
    spread: ParameterDraws | None = None
    specimen: Literal["new", "same", ""] = ""
    scanned: InsertionScan | None = None
    choices: tuple[str, ...] = ()
    warnings: tuple[ResultWarning, ...] = ()
    shown: ShownInsertion | None = None
    faults: tuple[str, ...] = ()

    @property
    def diameter(self) -> float:
        """Diameter at which the needle is drawn, mm."""
        return self.record.needle.outer_diameter_mm or DEFAULT_DIAMETER_MM
