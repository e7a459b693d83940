"""What `needlefit reconstruct` writes: tables and report, pages of scans, files for 3D Slicer."""

from typing import Literal

from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.schemas.study import AnalysisRecord
from needlefit.studies.kind import StudyKind


class ReconstructionBatchRecord(AnalysisRecord):
    """The scans of a batch, by their ids, and the recipe. Only `needlefit reconstruct` makes one."""

    kind: Literal["reconstruction"]
    scans: tuple[str, ...]
    """Ids of the scans."""
    recipe: ReconstructionRecord
    """The recipe of the reconstruction."""


KIND = StudyKind("reconstruction", ReconstructionBatchRecord, f"{__name__}.report")
