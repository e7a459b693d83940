"""The study file of a compression test, or the options of `needlefit material`."""

from typing import Literal

from needlefit.schemas.analyses import AnalysisRecord


class CompressionRecord(AnalysisRecord):
    """`kind = "material"`: a prior from a compression test."""

    kind: Literal["material"]
    file: str
    """Table of the compression test."""
    stress: Literal["nominal", "true"] | None = None
    """What column `stress_kpa` holds: force per initial area (nominal) or per present area (true)."""
    foundation: tuple[float, float] | None = None
    """Factor from the material's shear modulus to the model's mu, and the factor within which it is
    known."""
