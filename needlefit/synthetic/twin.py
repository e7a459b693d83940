"""One insertion of the twin, from its plan to what the scanner saw of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.project.streams import stream
from needlefit.synthetic.design import Planned
from needlefit.synthetic.insert import Inserted, insert
from needlefit.synthetic.measure import Registration, draw_registration, measure
from needlefit.synthetic.truth import Deviations, Specimen, true_deviations, true_needle, true_specimen

Floats = NDArray[np.float64]

SEED = 1
"""The seed of the twin that ships."""


@dataclass(frozen=True)
class Twin:
    """One insertion of the twin: as planned, as it really is, and as measured.

    Attributes
    ----------
    measured : (N, 3) array
        The centreline that the dataset gives, world, mm.
    """

    planned: Planned
    specimen: Specimen
    deviations: Deviations
    inserted: Inserted
    registration: Registration
    measured: Floats


def synthesize(planned: Planned, seed: int) -> Twin:
    """Simulate and measure one insertion; it depends on its own plan and the seed, not on the others."""
    specimen = true_specimen(seed, planned.medium, planned.specimen)
    deviations = true_deviations(seed, planned)
    inserted = insert(planned, true_needle(seed), specimen, deviations)
    registration = draw_registration(inserted.centerline, stream(seed, "twin", "registration", planned.id))
    measured = measure(inserted.centerline, registration, stream(seed, "twin", "noise", planned.id))
    return Twin(planned, specimen, deviations, inserted, registration, measured)
