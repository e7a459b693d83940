"""The design of the synthetic dataset: its phantoms, the insertions planned into them, the true parameters.

Drawn are the needle, the specimens, and the deviations of insertions from plan; of another
population also the media (`TrueSpread`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from needlefit.arrays import Floats
from needlefit.geometry.curves import make_normal
from needlefit.geometry.frames import normalize
from needlefit.geometry.surfaces import Surface, make_sheet
from needlefit.mechanics.needle import Needle
from needlefit.project.locate import unknown_name_error
from needlefit.project.random_streams import random_stream

BOX_MM = 80.0  # edge of the box, mm


def make_cylinder(
    name: str, ends: tuple[ArrayLike, ArrayLike], radius: float, into: int, facets: int = 96
) -> Surface:
    """Return a closed cylinder (an inscribed prism) between the centres `ends` of its faces; mm."""
    bottom, top = (np.asarray(end, dtype=np.float64) for end in ends)
    z = normalize(top - bottom, "cylinder axis")
    x = make_normal(z)
    angle = 2 * np.pi * np.arange(facets) / facets
    rim = radius * (np.outer(np.cos(angle), x) + np.outer(np.sin(angle), np.cross(z, x)))  # (facets, 3)
    vertices = np.vstack([bottom + rim, top + rim, bottom, top])
    i = np.arange(facets)
    j, centre_bottom, centre_top = (
        (i + 1) % facets,
        np.full(facets, 2 * facets),
        np.full(facets, 2 * facets + 1),
    )
    faces = np.vstack(
        [
            np.column_stack([i, j, j + facets]),
            np.column_stack([i, j + facets, i + facets]),
            np.column_stack([j, i, centre_bottom]),
            np.column_stack([i + facets, j + facets, centre_top]),
        ]
    )
    return Surface(name, vertices, faces, "solid", into)


@dataclass(frozen=True)
class Cylinder:
    """The solid in place of the prostate: a cylinder along y at height z = 0; it is layer 4."""

    top: float  # x of the line at which it comes closest to the entry face, mm
    # `radius`, `length`: mm
    radius: float
    length: float


@dataclass(frozen=True)
class Phantom:
    """A box with plane interfaces at `interfaces` (x, mm; the n-th leads into layer n + 1) and a cylinder."""

    interfaces: tuple[float, ...]
    cylinder: Cylinder | None = None

    @property
    def boundaries(self) -> int:
        return len(self.interfaces) + (self.cylinder is not None)


PHANTOMS = {
    "phantom1": Phantom((20.0, 26.0, 62.0)),
    "phantom2": Phantom((19.0, 27.0), Cylinder(top=40.0, radius=19.0, length=64.0)),
    "phantom3": Phantom((17.5, 22.5), Cylinder(top=35.5, radius=19.0, length=64.0)),
    "chicken": Phantom(()),
}


def displace(phantom: Phantom, shifts: Sequence[float]) -> Phantom:
    """Return the phantom with its boundaries moved along x by `shifts` (mm), from the entry inwards."""
    interfaces = tuple(x + dx for x, dx in zip(phantom.interfaces, shifts, strict=False))
    if phantom.cylinder is None:
        return Phantom(interfaces)
    return Phantom(interfaces, replace(phantom.cylinder, top=phantom.cylinder.top + shifts[-1]))


def make_surfaces(phantom: Phantom) -> tuple[Surface, ...]:
    """Return the boundaries of a phantom's layers as surfaces, from the entry inwards."""
    sheets = tuple(
        make_sheet(f"interface{n}", (x, 0, 0), (1, 0, 0), BOX_MM, into=n + 1)
        for n, x in enumerate(phantom.interfaces, start=1)
    )
    if phantom.cylinder is None:
        return sheets
    axis, half = phantom.cylinder.top + phantom.cylinder.radius, phantom.cylinder.length / 2
    ends = ((axis, -half, 0), (axis, half, 0))
    return (*sheets, make_cylinder("cylinder", ends, phantom.cylinder.radius, into=4))


def surface_file_name(medium: str, surface: Surface) -> str:
    return f"layers/{medium}_{surface.name}.stl"


@dataclass(frozen=True)
class InsertionDesign:
    """One planned insertion."""

    # `id`, `medium`, `specimen`: `specimen` is the piece that is punctured
    id: str
    medium: str
    specimen: str
    # `layers`, `layers_alternative`: layers met, and the other reading of a needle that ends at a boundary
    # (else the same)
    layers: int
    layers_alternative: int
    depth: float  # inserted arc length, mm
    tilt: float  # angle of the phantom on its stage, degrees, about the vertical z
    # `y`, `z`: entry position on the face x = 0, mm
    y: float
    z: float
    side: int  # the side of the entry axis that the bevel faces, +1: toward +y at tilt 0
    fibre_angle: float = 0.0  # angle between the bevel and the muscle's fibres, degrees; 0 in a phantom

    @property
    def origin(self) -> Floats:
        """The point of first contact, (3,), world, mm."""
        return np.array([0.0, self.y, self.z])

    @property
    def direction(self) -> Floats:
        """The stage's axis, (3,), world."""
        angle = math.radians(self.tilt)
        return np.array([math.cos(angle), math.sin(angle), 0.0])

    @property
    def toward(self) -> Floats:
        """The stated bevel direction, (3,), world: across the axis, in the xy plane."""
        angle = math.radians(self.tilt)
        return self.side * np.array([-math.sin(angle), math.cos(angle), 0.0])


# depth mm, tilt deg, y mm, z mm, side; in phantom 2 also the layers, and the layers read otherwise
_PHANTOM1 = (
    (50.69, 0, 2.0, -8.0, 1),
    (51.12, 10, -9.0, 10.0, -1),
    (51.58, -10, 6.0, -15.0, 1),
    (51.97, 20, -14.0, 4.0, 1),
    (52.33, -20, 12.0, 14.0, -1),
    (52.71, 0, -7.0, 20.0, -1),
    (53.06, 10, 1.0, -22.0, 1),
    (53.42, -10, 15.0, 0.0, -1),
    (53.85, 30, -18.0, 9.0, -1),
    (54.27, -30, 17.0, -6.0, 1),
)
_PHANTOM2 = (
    (49.09, 0, 3.0, -4.0, 1, 4, 4),
    (50.27, 30, -16.0, 12.6, -1, 4, 3),
    (51.34, -10, 7.0, 0.0, -1, 4, 4),
    (52.18, 20, -15.0, -7.0, 1, 4, 4),
    (52.95, -20, 13.0, 3.0, -1, 4, 4),
    (53.82, 0, -5.0, 9.0, -1, 4, 4),
    (54.66, 10, -8.0, 6.0, 1, 4, 4),
    (55.51, -10, 11.0, -9.0, 1, 4, 4),
    (56.49, -30, 17.0, 2.0, 1, 4, 4),
    (33.60, 0, 0.0, 5.0, -1, 3, 3),
    (50.83, 10, -6.0, 29.0, -1, 3, 3),
    (52.41, -20, 14.0, -28.0, 1, 3, 3),
    (53.67, 0, 4.0, -31.0, 1, 3, 3),
    (54.78, 20, -12.0, 30.0, -1, 3, 3),
    (23.79, 10, -3.0, -12.0, 1, 2, 2),
    (19.63, -30, 8.0, 7.0, -1, 1, 1),
)
_PHANTOM3 = (
    (37.68, 0, -2.0, 0.0, 1),
    (45.21, 10, -7.0, 5.0, -1),
    (48.36, -10, 6.0, -6.0, 1),
    (50.14, 0, 4.0, 9.0, -1),
    (51.57, 20, -13.0, -3.0, 1),
    (52.69, -20, 12.0, 7.0, -1),
    (53.72, 10, -10.0, -10.0, 1),
    (54.58, -30, 16.0, 4.0, 1),
    (55.32, 30, -17.0, 1.0, -1),
)
# depth mm, tilt deg, y mm, z mm, side, fibre angle deg; the first three in piece 1, the next three in
# piece 2, the others in piece 3, which is turned after its first three
_CHICKEN = (
    (38.47, 0, -12.0, 3.0, 1, 62.0),
    (50.92, 0, 5.0, -9.0, -1, 53.0),
    (57.43, 0, 14.0, 8.0, 1, 48.0),
    (26.98, 0, -10.0, -6.0, 1, 71.0),
    (47.36, 0, 2.0, 11.0, -1, 55.0),
    (55.14, 0, 13.0, -3.0, 1, 42.0),
    (44.25, 10, -14.0, 6.0, -1, 65.0),
    (53.08, 10, -3.0, -10.0, 1, 53.0),
    (61.22, 10, 4.0, 2.0, 1, 12.0),
    (34.71, -30, 17.0, -5.0, 1, 72.0),
    (51.59, -30, 10.0, 9.0, -1, 55.0),
    (58.85, -30, 21.0, 0.0, -1, 46.0),
)


def list_designs() -> tuple[InsertionDesign, ...]:
    """Return all 47 insertions, phantom by phantom; the plan is the same for every seed."""
    phantoms = (
        *(_in_phantom("phantom1", n, (*row, 3, 3)) for n, row in enumerate(_PHANTOM1, start=1)),
        *(_in_phantom("phantom2", n, row) for n, row in enumerate(_PHANTOM2, start=1)),
        *(_in_phantom("phantom3", n, (*row, 4, 4)) for n, row in enumerate(_PHANTOM3, start=1)),
    )
    pieces = (1, 1, 1, 2, 2, 2, 3, 3, 3, 3, 3, 3)
    chicken = (
        InsertionDesign(
            f"chicken-{n:02}", "chicken", f"chicken-piece{piece}", 1, 1, *row[:4], int(row[4]), row[5]
        )
        for n, piece, row in zip(count(1), pieces, _CHICKEN, strict=False)
    )
    return (*phantoms, *chicken)


def select_designs(names: Sequence[str]) -> tuple[InsertionDesign, ...]:
    """Return the insertions of these ids, in this order; all 47 if there are none.

    ConfigError if there is no such insertion; the nearest ids are listed.
    """
    designs = {planned.id: planned for planned in list_designs()}
    for name in names:
        if name not in designs:
            raise unknown_name_error("insertion of the twin", name, list(designs), "")
    return tuple(designs[name] for name in dict.fromkeys(names)) or list_designs()


def _in_phantom(
    medium: str, n: int, row: tuple[float, float, float, float, int, int, int]
) -> InsertionDesign:
    *pose, side, layers, alternative = row
    depth, tilt, y, z = pose
    return InsertionDesign(f"{medium}-{n:02}", medium, medium, layers, alternative, depth, tilt, y, z, side)


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
        return self.sd * np.sqrt(2 / len(self.phases)) * np.cos(angles).sum(axis=1)


@dataclass(frozen=True)
class MediumTruth:
    """The true layers of a medium before its specimens vary, its bevel offset, and how they vary."""

    tissue: Literal["gel", "muscle"]
    # `mu_pa`, `alpha`: one per layer, from the paper's table of parameters (sets by media)
    mu_pa: tuple[float, ...]
    alpha: tuple[float, ...]
    bevel: float  # b, mm per 1 mm: chosen so that the tips deflect as much as the paper's tables imply
    friction: float  # gamma between shaft and tissue
    hu: tuple[float, ...]  # what each layer reads in a CT scan
    layer_sd: float  # of ln mu, of each layer of each specimen by itself
    # The bevel offset is 1 - k + 2 k cos^2 of the angle between bevel and fibres times that of its specimen,
    # once on average over angles: muscle is cut along its fibres rather than across them.
    fibre_dependence: float = 0.0
    # Between specimens: SDs of ln mu, the same of all layers, and of ln b, and their correlation.
    modulus_sd: float = 0.0
    bevel_sd: float = 0.0
    correlation: float = 0.0
    insertion_bevel_sd: float = 0.0  # of ln b, between insertions of one specimen


GEL_HU = (20.0, 90.0, 35.0, 105.0)  # a stiffer gel holds more solids, and reads brighter
TRUE_MEDIA = {
    "phantom1": MediumTruth("gel", (2e5, 3.3e7, 2e6, 3.3e7), (1, -1, 1, -1), 0.03, 0.2, GEL_HU, 0.1),
    "phantom2": MediumTruth("gel", (2e5, 3.3e7, 2e5, 3.3e7), (1, -1, 1, -1), 0.103, 0.2, GEL_HU, 0.1),
    "phantom3": MediumTruth("gel", (2e5, 3.3e7, 2e5, 3.3e7), (1, -1, 1, -1), 0.03, 0.2, GEL_HU, 0.1),
    "chicken": MediumTruth("muscle", (1e3,), (1,), 0.33, 0.1, (55.0,), 0.3, fibre_dependence=1.0),
}


@dataclass(frozen=True)
class TrueSpread:
    """The population from which the media of a truth may be drawn, gel and muscle apart.

    A factor f stands for the standard deviation ln f of a logarithm. Of one truth the moduli are those of
    `TRUE_MEDIA`, times a factor for each of the two materials; so phantom 1 keeps its stiffer third layer.
    Drawn besides are the correlation between ln mu and ln b of specimens, uniform on (-1, 1), and the
    dependence on fibres in muscle, uniform between none and that of `TRUE_MEDIA`. The paper states nothing
    about friction and fibres; their ranges are decided here. No width was chosen by the coverage it leads to.
    """

    # Of the mean over all specimens: the paper's moduli of one material lie within a factor of 2 of their
    # middle (mu1 5e4 to 2.2e5 Pa); the mean ln b of its three phantoms is known to ln 1.8 / sqrt(3).
    mean_modulus_factor: float = 2.0
    mean_bevel_factor: float = 1.4
    gel_bevel: float = (0.03 * 0.085 * 0.03) ** (1 / 3)  # geometric mean of the paper's phantoms, mm per 1 mm
    # Between specimens of one truth: the SDs have half-normal priors of the size that the recipe states.
    modulus_factor: float = 2.0
    bevel_factor: float = 1.8
    layer_sd: float = 0.1  # of ln mu, between layers of nominally one material
    insertion_bevel_sd: float = 0.1  # size of the half-normal prior of `MediumTruth.insertion_bevel_sd`
    friction_factor: float = 2.0  # friction is log-uniform between that of `TRUE_MEDIA` over and times this


POPULATION = TrueSpread()

# The needle as the dataset states it.
NOMINAL_NEEDLE = Needle.from_tube(length=150.0, outer_diameter=1.27, youngs_modulus=80e3)
RIGIDITY_DEVIATION = (0.02, 0.05)  # relative deviation of the true EI from the nominal one, up or down
FIELD_LOG_MU_SD = 0.4  # of ln mu within a piece of chicken
FIELD_LENGTH_MM = 12.0  # distance (mm) over which ln mu varies within a piece of chicken
LAYER_SD_MM = 0.1  # of a layer's boundary about the place its surface file states, mm along x
ROLL_SD_DEG = 3.0  # degrees between the stated and the true bevel plane
# Of the stage axis in the world, per direction.
POSE_SHIFT_SD_MM = 0.05  # standard deviation (mm) of the stage axis, per direction
POSE_ANGLE_SD_DEG = 0.05  # standard deviation (degrees) of the stage axis, per direction


@dataclass(frozen=True)
class TrueSpecimen:
    """One phantom, or one piece of chicken, with its true parameters."""

    name: str
    medium: str
    # `mu`, `alpha`: (n,); of each layer; mu in MPa
    mu: Floats
    alpha: Floats
    # `bevel`, `friction`, `fibre_dependence`, `insertion_bevel_sd`: as in `MediumTruth`
    bevel: float
    friction: float
    fibre_dependence: float
    insertion_bevel_sd: float
    phantom: Phantom  # where the boundaries of the layers really are
    surfaces: tuple[Surface, ...]  # the same as meshes
    # ln(mu / `mu`) from place to place, where the specimen is not homogeneous.
    field: RandomField | None = None


@dataclass(frozen=True)
class DesignDeviations:
    """The deviations of one insertion from its plan."""

    shift: Floats  # (2,); of the entry, along the stated bevel direction and normal to it, mm
    tilt: Floats  # (2,); of the entry axis, toward the same two directions, rad
    roll: float  # of the bevel's plane about the needle, rad
    # (2,); standard normal: how strongly the needle leaves its plane, in two smooth modes.
    out_of_plane: Floats
    bevel: float  # of ln b from its specimen's, in standard deviations


def draw_needle(seed: int) -> Needle:
    """Draw the true needle: its rigidity is a few percent off the nominal one."""
    rng = random_stream(seed, "twin", "needle")
    off = rng.choice([-1, 1]) * rng.uniform(*RIGIDITY_DEVIATION)
    return Needle(NOMINAL_NEEDLE.length, NOMINAL_NEEDLE.flexural_rigidity * (1 + float(off)))


def draw_medium(seed: int, name: str, population: TrueSpread | None = None) -> MediumTruth:
    """Draw a medium from a population; without one, media are those of `TRUE_MEDIA`."""
    nominal = TRUE_MEDIA[name]
    if population is None:
        return nominal
    # the media of one tissue share what is drawn: they are specimens of one population
    rng = random_stream(seed, "twin", "population", nominal.tissue)
    materials = np.exp(np.log(population.mean_modulus_factor) * rng.normal(size=2))
    bevel = nominal.bevel if nominal.tissue == "muscle" else population.gel_bevel
    layers = len(nominal.mu_pa)
    return replace(
        nominal,
        # two materials alternate
        mu_pa=tuple((np.array(nominal.mu_pa) * np.resize(materials, layers)).tolist()),
        bevel=bevel * float(np.exp(np.log(population.mean_bevel_factor) * rng.normal())),
        friction=nominal.friction * float(population.friction_factor ** rng.uniform(-1, 1)),
        layer_sd=population.layer_sd if layers > 1 else 0.0,
        fibre_dependence=nominal.fibre_dependence * float(rng.uniform()),
        modulus_sd=float(np.log(population.modulus_factor) * abs(rng.normal())),
        bevel_sd=float(np.log(population.bevel_factor) * abs(rng.normal())),
        correlation=float(rng.uniform(-1, 1)),
        insertion_bevel_sd=float(population.insertion_bevel_sd * abs(rng.normal())),
    )


def draw_specimen(seed: int, medium: str, name: str, population: TrueSpread | None = None) -> TrueSpecimen:
    truth, rng = draw_medium(seed, medium, population), random_stream(seed, "twin", "specimen", name)
    factors = np.exp(truth.layer_sd * rng.normal(size=len(truth.mu_pa)))
    shifts = LAYER_SD_MM * rng.normal(size=PHANTOMS[medium].boundaries)
    phantom = displace(PHANTOMS[medium], shifts.tolist())
    field = RandomField.draw(rng, FIELD_LOG_MU_SD, FIELD_LENGTH_MM) if truth.tissue == "muscle" else None
    stiffer, other = rng.normal(size=2)
    sideways = truth.correlation * stiffer + math.sqrt(1 - truth.correlation**2) * other
    return TrueSpecimen(
        name=name,
        medium=medium,
        mu=1e-6 * np.array(truth.mu_pa) * factors * math.exp(truth.modulus_sd * stiffer),
        alpha=np.array(truth.alpha, dtype=np.float64),
        bevel=truth.bevel * math.exp(truth.bevel_sd * sideways),
        friction=truth.friction,
        fibre_dependence=truth.fibre_dependence,
        insertion_bevel_sd=truth.insertion_bevel_sd,
        phantom=phantom,
        surfaces=make_surfaces(phantom),
        field=field,
    )


def draw_deviations(seed: int, planned: InsertionDesign) -> DesignDeviations:
    """Draw the deviations of an insertion from its plan; they are keyed by its id alone."""
    rng = random_stream(seed, "twin", "insertion", planned.id)
    return DesignDeviations(
        shift=POSE_SHIFT_SD_MM * rng.normal(size=2),
        tilt=np.radians(POSE_ANGLE_SD_DEG) * rng.normal(size=2),
        roll=float(np.radians(ROLL_SD_DEG) * rng.normal()),
        out_of_plane=rng.normal(size=2),
        bevel=float(rng.normal()),
    )


def bevel_offset(specimen: TrueSpecimen, planned: InsertionDesign, deviations: DesignDeviations) -> float:
    along = 2 * np.cos(np.radians(planned.fibre_angle)) ** 2
    by_fibres = 1 - specimen.fibre_dependence + specimen.fibre_dependence * along
    return float(specimen.bevel * by_fibres * np.exp(specimen.insertion_bevel_sd * deviations.bevel))
