"""The options of `needlefit reconstruct` that stand for a study file."""

from typing import Literal

from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.reconstruction import ReconstructionRecord


class ReconstructionBatchRecord(AnalysisRecord):
    """The scans of a batch, by their ids, and the recipe. Only `needlefit reconstruct` makes one."""

    kind: Literal["reconstruction"]
    scans: tuple[str, ...]
    """Ids of the scans."""
    recipe: ReconstructionRecord
    """The recipe of the reconstruction."""
