"""The study file of a verification, or the options of `needlefit verify`."""

from typing import Literal

from pydantic import Field

from needlefit.schemas.analyses import AnalysisRecord


class VerificationRecord(AnalysisRecord):
    """`kind = "verification"`: is the solver correct?"""

    kind: Literal["verification"]
    seed: int = Field(default=1, ge=0)
    """Seed of the random cases."""
