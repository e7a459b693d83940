"""Draw the synthetic dataset's true parameters: needle, specimens, deviations of insertions from plan."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from needlefit.arrays import Floats
from needlefit.geometry.surfaces import Surface
from needlefit.mechanics.needle import Needle
from needlefit.project.random_streams import random_stream
from needlefit.synthetic.design import PHANTOMS, Phantom, PlannedInsertion, displace, make_surfaces


@dataclass(frozen=True)
class RandomField:
    """A stationary, isotropic random field of mean 0: a sum of plane waves of random direction and phase.

    Wave vectors drawn from N(0, 1/l^2) give the covariance sd^2 exp(-r^2 / (2 l^2)).
    """

    waves: Floats  # (n, 3); wave vectors, rad/mm
    phases: Floats  # (n,); rad
    sd: float  # standard deviation over all fields

    @classmethod
    def draw(cls, rng: np.random.Generator, sd: float, length: float, waves: int = 64) -> Self:
        """Draw a field of deviation `sd` and correlation length `length` (mm)."""
        return cls(rng.normal(0, 1 / length, (waves, 3)), rng.uniform(0, 2 * np.pi, waves), sd)

    def at(self, points: ArrayLike) -> Floats:
        """Return the field (N,) at world `points` (N, 3)."""
        angles = np.asarray(points, dtype=np.float64) @ self.waves.T + self.phases  # (N, n)
        field: Floats = self.sd * np.sqrt(2 / len(self.phases)) * np.cos(angles).sum(axis=1)
        return field


@dataclass(frozen=True)
class MediumTruth:
    """The true layers of a medium before its specimens vary, and its bevel offset."""

    # `mu_pa`, `alpha`: one per layer, from the paper's table of parameters (sets by media)
    mu_pa: tuple[float, ...]
    alpha: tuple[float, ...]
    bevel: float  # b, mm per 1 mm: chosen so that the tips deflect as much as the paper's tables imply
    friction: float  # gamma between shaft and tissue
    hu: tuple[float, ...]  # what each layer reads in a CT scan


GEL_HU = (20.0, 90.0, 35.0, 105.0)  # a stiffer gel holds more solids, and reads brighter
TRUE_MEDIA = {
    "phantom1": MediumTruth((2e5, 3.3e7, 2e6, 3.3e7), (1, -1, 1, -1), 0.03, 0.2, GEL_HU),
    "phantom2": MediumTruth((2e5, 3.3e7, 2e5, 3.3e7), (1, -1, 1, -1), 0.103, 0.2, GEL_HU),
    "phantom3": MediumTruth((2e5, 3.3e7, 2e5, 3.3e7), (1, -1, 1, -1), 0.03, 0.2, GEL_HU),
    "chicken": MediumTruth((1e3,), (1,), 0.33, 0.1, (55.0,)),
}

# The needle as the dataset states it.
NOMINAL_NEEDLE = Needle.from_tube(length=150.0, outer_diameter=1.27, youngs_modulus=80e3)
RIGIDITY_DEVIATION = (0.02, 0.05)  # relative deviation of the true EI from the nominal one, up or down
LOG_MU_SD = {"phantom1": 0.1, "phantom2": 0.1, "phantom3": 0.1, "chicken": 0.3}  # of ln mu, between specimens
FIELD_LOG_MU_SD, FIELD_LENGTH_MM = 0.4, 12.0  # of ln mu within a piece of chicken, and mm
LAYER_SD_MM = 0.1  # of a layer's boundary about the place its surface file says, mm along x
ROLL_SD_DEG = 3.0  # degrees between the stated and the true bevel plane
POSE_SHIFT_SD_MM, POSE_ANGLE_SD_DEG = (
    0.05,
    0.05,
)  # of the stage axis in the world, mm and degrees, per direction


@dataclass(frozen=True)
class TrueSpecimen:
    """One phantom, or one piece of chicken, with its true parameters."""

    name: str
    medium: str
    # `mu`, `alpha`: (n,); of each layer; mu in MPa
    mu: Floats
    alpha: Floats
    # `bevel`, `friction`: as in `MediumTruth`
    bevel: float
    friction: float
    phantom: Phantom  # where the boundaries of the layers really are
    surfaces: tuple[Surface, ...]  # the same as meshes
    # ln(mu / `mu`) from place to place, where the specimen is not homogeneous.
    field: RandomField | None = None


@dataclass(frozen=True)
class PlanDeviations:
    """The deviations of one insertion from its plan."""

    shift: Floats  # (2,); of the entry, along the stated bevel direction and normal to it, mm
    tilt: Floats  # (2,); of the entry axis, toward the same two directions, rad
    roll: float  # of the bevel's plane about the needle, rad
    # (2,); standard normal: how strongly the needle leaves its plane, in two smooth modes.
    out_of_plane: Floats


def draw_needle(seed: int) -> Needle:
    """Draw the true needle: its rigidity is a few percent off the nominal one."""
    rng = random_stream(seed, "twin", "needle")
    off = rng.choice([-1, 1]) * rng.uniform(*RIGIDITY_DEVIATION)
    return Needle(NOMINAL_NEEDLE.length, NOMINAL_NEEDLE.flexural_rigidity * (1 + float(off)))


def draw_specimen(seed: int, medium: str, name: str) -> TrueSpecimen:
    """Draw a specimen of a medium."""
    truth, rng = TRUE_MEDIA[medium], random_stream(seed, "twin", "specimen", name)
    factors = np.exp(LOG_MU_SD[medium] * rng.normal(size=len(truth.mu_pa)))
    shifts = LAYER_SD_MM * rng.normal(size=PHANTOMS[medium].boundaries)
    phantom = displace(PHANTOMS[medium], shifts.tolist())
    return TrueSpecimen(
        name=name,
        medium=medium,
        mu=1e-6 * np.array(truth.mu_pa) * factors,
        alpha=np.array(truth.alpha, dtype=np.float64),
        bevel=truth.bevel,
        friction=truth.friction,
        phantom=phantom,
        surfaces=make_surfaces(phantom),
        field=RandomField.draw(rng, FIELD_LOG_MU_SD, FIELD_LENGTH_MM) if medium == "chicken" else None,
    )


def draw_deviations(seed: int, planned: PlannedInsertion) -> PlanDeviations:
    """Draw the deviations of an insertion from its plan; they are keyed by its id alone."""
    rng = random_stream(seed, "twin", "insertion", planned.id)
    return PlanDeviations(
        shift=POSE_SHIFT_SD_MM * rng.normal(size=2),
        tilt=np.radians(POSE_ANGLE_SD_DEG) * rng.normal(size=2),
        roll=float(np.radians(ROLL_SD_DEG) * rng.normal()),
        out_of_plane=rng.normal(size=2),
    )


def bevel_offset(specimen: TrueSpecimen, planned: PlannedInsertion) -> float:
    """Return the bevel offset (mm) of an insertion.

    A phantom cuts alike in every direction. Muscle is cut along its fibres rather than across them: the
    offset is 2 cos^2 of the angle between bevel and fibres times its medium's, once on average over angles.
    """
    if specimen.medium != "chicken":
        return specimen.bevel
    return float(specimen.bevel * 2 * np.cos(np.radians(planned.fibre_angle)) ** 2)
