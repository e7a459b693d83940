"""How a phantom is scanned: which part of it, and with which markers.

The balls are embedded near the walls of the box, off every planned needle. Before each scan their places are
measured with a probe, which errs by `known_sd`: what is stated of them differs from scan to scan.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.project.streams import stream
from needlefit.synthetic import design
from needlefit.synthetic.design import Planned
from needlefit.synthetic.phantoms import BOX

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Setup:
    """What the scanner's field holds.

    Attributes
    ----------
    markers : (M, 3) array
        Centres of the balls, world, mm.
    known_sd : float
        Deviation of their stated places in any one direction, mm.
    low, high : (3,) arrays
        Opposite corners of the part of the world that is scanned, mm.
    outside : float
        Length of shaft before the tissue that is scanned, mm.
    """

    markers: Floats
    known_sd: float
    low: Floats
    high: Floats
    outside: float


WHOLE = Setup(
    markers=np.array(
        [
            [4.0, 36.0, 35.0],
            [7.0, -36.0, 30.0],
            [12.0, -35.0, -36.0],
            [24.0, 37.0, -34.0],
            [43.0, 34.0, 36.0],
            [58.0, -37.0, 12.0],
            [74.0, -12.0, -36.0],
            [76.0, 29.0, 21.0],
        ]
    ),
    known_sd=0.27,
    low=np.array([0.0, -BOX / 2, -BOX / 2 - 5.0]),  # and some of the table
    high=np.array([BOX, BOX / 2, BOX / 2]),
    outside=35.0,
)
"""The box, some of its table, and the shaft before it."""

SAMPLE = Setup(
    markers=np.array(
        [[4.0, 11.5, -1.0], [9.0, -6.0, 8.0], [15.0, 3.0, -14.0], [22.0, -7.0, -7.0], [26.0, 12.0, 4.0]]
    ),
    known_sd=0.1,
    low=np.array([0.0, -10.0, -17.0]),
    high=np.array([30.0, 15.0, 11.0]),
    outside=12.0,
)
"""Some gel around a short needle: a volume of a megabyte, its markers close by."""


def setup_of(planned: Planned) -> Setup:
    """Return how an insertion is scanned."""
    return SAMPLE if planned.id == design.SAMPLE.id else WHOLE


def stated_markers(setup: Setup, seed: int, name: str) -> Floats:
    """Return the places (M, 3) of the markers as measured before the scan `name`, world, mm."""
    rng = stream(seed, "twin", "markers", name)
    measured: Floats = setup.markers + setup.known_sd * rng.normal(size=setup.markers.shape)
    return measured
