"""Describe the synthetic CT scene (needle, phantom, markers, table) and the properties of the scanner."""

from dataclasses import dataclass, field

import numpy as np

from needlefit.arrays import Floats
from needlefit.geometry.frames import Frame
from needlefit.imaging.volume import VoxelGrid
from needlefit.synthetic.design import Phantom

WATER_PER_MM = 0.02
"""Attenuation of water at the energies of a cone-beam scanner, 1/mm."""


@dataclass(frozen=True)
class Needle3D:
    """The steel needle in the scanner."""

    points: Floats  # (N, 3); the shaft's axis from base to tip, patient (LPS), mm
    diameter: float = 1.27  # mm
    bevel_deg: float = 30.0  # angle between the bevel's face and the axis; 90 is a blunt end
    # (3,); the direction across the axis in which the bevel's point lies.
    bevel_toward: Floats = field(default_factory=lambda: np.array([0.0, 1.0, 0.0]))
    hu: float = 9000.0  # what the metal would read without a ceiling


@dataclass(frozen=True)
class SceneMarkers:
    """Radiopaque balls: `centers` (M, 3) patient, `radius` mm, and their `hu` without a ceiling."""

    centers: Floats
    radius: float = 1.5
    hu: float = 5000.0


@dataclass(frozen=True)
class ScannerTable:
    """The table: a slab under the phantom, and the rails along its edges."""

    frame: Frame  # origin on the slab's upper face; x along the table, y across it, z up
    # `width`, `thickness`: mm
    width: float = 300.0
    thickness: float = 8.0
    # `hu`, `rail_hu`: of the slab and of its two rails, 8 mm wide
    hu: float = -100.0
    rail_hu: float = 2800.0


@dataclass(frozen=True)
class Scene3D:
    """Everything that lies in the scanner."""

    needles: tuple[Needle3D, ...]  # one, in a proper scan
    phantom: Phantom  # the box of layers
    layers_hu: tuple[float, ...]  # one a layer, from the entry inwards
    box: Frame  # the phantom's world in the patient: origin at the middle of the entry face, x into the box
    markers: SceneMarkers | None = None
    table: ScannerTable | None = None


@dataclass(frozen=True)
class Scanner:
    """The scanner: grid, blur, noise, artefacts and range; slices of the grid are planes of its rotation."""

    grid: VoxelGrid
    psf_mm: float = 0.4  # standard deviation of the point spread
    # `noise_hu`, `noise_mm`: standard deviation of the noise, and of the Gaussian that correlates it
    noise_hu: float = 40.0
    noise_mm: float = 0.25
    # `bloom`, `bloom_mm`: part of the metal's signal that is spread wider, and how wide (standard deviation)
    bloom: float = 0.12
    bloom_mm: float = 1.0
    streaks: float = 1.0  # strength of the rays from metal; 0 is none, 1 that of a scanner with no correction
    cupping_hu: float = 60.0  # how much too dark the middle of the phantom is
    # `floor_hu`, `ceiling_hu`: range of the stored numbers
    floor_hu: float = -1024.0
    ceiling_hu: float = 3071.0
    views: int = 180  # projections over half a turn
