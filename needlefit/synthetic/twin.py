"""One insertion of the twin, from its plan to what it really is."""

from dataclasses import dataclass

from needlefit.synthetic.design import Planned
from needlefit.synthetic.insert import Inserted, insert
from needlefit.synthetic.truth import Deviations, Specimen, true_deviations, true_needle, true_specimen

SEED = 1
"""The seed of the twin that ships."""


@dataclass(frozen=True)
class Twin:
    """One insertion of the twin: as planned, and as it really is."""

    planned: Planned
    specimen: Specimen
    deviations: Deviations
    inserted: Inserted


def synthesize(planned: Planned, seed: int) -> Twin:
    """Simulate one insertion; it depends on its own plan and the seed, not on the others."""
    specimen = true_specimen(seed, planned.medium, planned.specimen)
    deviations = true_deviations(seed, planned)
    return Twin(planned, specimen, deviations, insert(planned, true_needle(seed), specimen, deviations))
