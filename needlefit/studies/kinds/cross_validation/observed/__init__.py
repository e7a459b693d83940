"""Figures of insertions by how they were observed: a file of this folder for each observation that has some.

Each has the name of its observation in `inference/likelihood/observations/`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from needlefit.registry import Registry
from needlefit.reporting.figures import Drawing
from needlefit.studies.run import Run


@dataclass(frozen=True)
class ObservationFigures:
    """What is drawn of an observation."""

    name: str  #: of the observation
    #: run, role -> the figures of what was observed so, the one for the first page first; none without any
    draw: Callable[[Run, str], Mapping[str, Drawing]]


OBSERVATION_FIGURES = Registry(ObservationFigures, __name__, "figures of an observation")


def draw_observations(run: Run, role: str) -> dict[str, Drawing]:
    """Return the figures of all that was measured of insertions of a role, those of whole needles first."""
    ordered = sorted(OBSERVATION_FIGURES.values(), key=lambda figure: figure.name != "points")
    return {name: drawing for observation in ordered for name, drawing in observation.draw(run, role).items()}
