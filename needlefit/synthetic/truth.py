"""What is true in the twin: needle, specimens, the deviations of each insertion."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.geometry.surfaces import Surface
from needlefit.mechanics.needle import Needle
from needlefit.project.streams import stream
from needlefit.synthetic.design import Planned
from needlefit.synthetic.field import Field
from needlefit.synthetic.phantoms import PHANTOMS, Phantom, displaced, surfaces

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MediumTruth:
    """The layers of a medium before its specimens vary, and its bevel offset.

    Attributes
    ----------
    mu_pa, alpha : tuple of float
        One per layer, from the paper's table of parameters (sets by media).
    bevel : float
        b, mm per 1 mm: chosen so that the tips deflect as much as the paper's tables imply.
    friction : float
        gamma between shaft and tissue.
    hu : tuple of float
        What each layer reads in a CT scan.
    """

    mu_pa: tuple[float, ...]
    alpha: tuple[float, ...]
    bevel: float
    friction: float
    hu: tuple[float, ...]


GELS = (20.0, 90.0, 35.0, 105.0)
"""A stiffer gel holds more solids, and reads brighter."""

MEDIA = {
    "phantom1": MediumTruth((2e5, 3.3e7, 2e6, 3.3e7), (1, -1, 1, -1), 0.03, 0.2, GELS),
    "phantom2": MediumTruth((2e5, 3.3e7, 2e5, 3.3e7), (1, -1, 1, -1), 0.103, 0.2, GELS),
    "phantom3": MediumTruth((2e5, 3.3e7, 2e5, 3.3e7), (1, -1, 1, -1), 0.03, 0.2, GELS),
    "chicken": MediumTruth((1e3,), (1,), 0.33, 0.1, (55.0,)),
}

NOMINAL = Needle.from_tube(length=150.0, outer_diameter=1.27, youngs_modulus=80e3)
"""The needle as the dataset states it."""

RIGIDITY_OFF = (0.02, 0.05)  # relative deviation of the true EI from the nominal one, up or down
MU_SD = {"phantom1": 0.1, "phantom2": 0.1, "phantom3": 0.1, "chicken": 0.3}  # of ln mu, between specimens
FIELD_SD, FIELD_LENGTH = 0.4, 12.0  # of ln mu within a piece of chicken, and mm
LAYER_SD = 0.1  # of a layer's boundary about the place its surface file says, mm along x
ROLL_SD = 3.0  # degrees between the stated and the true bevel plane
POSE_SHIFT_SD, POSE_ANGLE_SD = 0.05, 0.05  # of the stage axis in the world, mm and degrees, per direction


@dataclass(frozen=True)
class Specimen:
    """One phantom, or one piece of chicken, as it really is.

    Attributes
    ----------
    mu, alpha : (n,) arrays
        Of each layer; mu in MPa.
    bevel, friction : float
        As in `MediumTruth`.
    phantom : Phantom
        Where the boundaries of the layers really are.
    surfaces : tuple of Surface
        The same as meshes.
    field : Field or None
        ln(mu / `mu`) from place to place, where the specimen is not homogeneous.
    """

    name: str
    medium: str
    mu: Floats
    alpha: Floats
    bevel: float
    friction: float
    phantom: Phantom
    surfaces: tuple[Surface, ...]
    field: Field | None = None


@dataclass(frozen=True)
class Deviations:
    """How one insertion departs from its plan.

    Attributes
    ----------
    shift : (2,) array
        Of the entry, along the stated bevel direction and normal to it, mm.
    tilt : (2,) array
        Of the entry axis, toward the same two directions, rad.
    roll : float
        Of the bevel's plane about the needle, rad.
    out_of_plane : (2,) array
        Standard normal: how strongly the needle leaves its plane, in two smooth modes.
    """

    shift: Floats
    tilt: Floats
    roll: float
    out_of_plane: Floats


def true_needle(seed: int) -> Needle:
    """Return the needle as it really is: its rigidity is a few percent off."""
    rng = stream(seed, "twin", "needle")
    off = rng.choice([-1, 1]) * rng.uniform(*RIGIDITY_OFF)
    return Needle(NOMINAL.length, NOMINAL.flexural_rigidity * (1 + float(off)))


def true_specimen(seed: int, medium: str, name: str) -> Specimen:
    """Return a specimen drawn around its medium."""
    truth, rng = MEDIA[medium], stream(seed, "twin", "specimen", name)
    factors = np.exp(MU_SD[medium] * rng.normal(size=len(truth.mu_pa)))
    shifts = LAYER_SD * rng.normal(size=PHANTOMS[medium].boundaries)
    phantom = displaced(PHANTOMS[medium], shifts.tolist())
    return Specimen(
        name=name,
        medium=medium,
        mu=1e-6 * np.array(truth.mu_pa) * factors,
        alpha=np.array(truth.alpha, dtype=np.float64),
        bevel=truth.bevel,
        friction=truth.friction,
        phantom=phantom,
        surfaces=surfaces(phantom),
        field=Field.draw(rng, FIELD_SD, FIELD_LENGTH) if medium == "chicken" else None,
    )


def true_deviations(seed: int, planned: Planned) -> Deviations:
    """Return how an insertion departs from its plan; keyed by its id alone."""
    rng = stream(seed, "twin", "insertion", planned.id)
    return Deviations(
        shift=POSE_SHIFT_SD * rng.normal(size=2),
        tilt=np.radians(POSE_ANGLE_SD) * rng.normal(size=2),
        roll=float(np.radians(ROLL_SD) * rng.normal()),
        out_of_plane=rng.normal(size=2),
    )


def true_bevel(specimen: Specimen, planned: Planned) -> float:
    """Return the bevel offset (mm) of an insertion.

    A phantom cuts alike in every direction. Muscle is cut along its fibres rather than across them: the
    offset is 2 cos^2 of the angle between bevel and fibres times its medium's, once on average over angles.
    """
    if specimen.medium != "chicken":
        return specimen.bevel
    return float(specimen.bevel * 2 * np.cos(np.radians(planned.grain)) ** 2)
