"""The study file of an identifiability analysis, or the options of `needlefit identify`."""

from typing import Literal

from needlefit.schemas.analyses import TargetRecord


class IdentificationRecord(TargetRecord):
    """`kind = "identification"`: which parameters the insertions determine."""

    kind: Literal["identification"]
    fit: bool = False
    """Whether the insertions are fitted too, so that the measured shapes are analysed beside the design."""
