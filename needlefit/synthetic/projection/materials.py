"""Attenuation of materials by photon energy, and the spectrum of an X-ray tube.

Mass attenuation coefficients are those of NIST (Hubbell and Seltzer, Standard Reference Database 126), cm2/g;
between two energies log is interpolated over log. No material has an absorption edge in the range.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats

TABLE_ENERGIES_KEV = np.array([30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 150.0])

MASS_ATTENUATION_CM2_PER_G = {
    "O": (0.3779, 0.2585, 0.2132, 0.1907, 0.1678, 0.1551, 0.1361),
    "Na": (0.7197, 0.3969, 0.2804, 0.2268, 0.1796, 0.1585, 0.1335),
    "Al": (1.128, 0.5685, 0.3681, 0.2778, 0.2018, 0.1704, 0.1378),
    "Si": (1.436, 0.7012, 0.4385, 0.3207, 0.2228, 0.1835, 0.1448),
    "Ca": (4.080, 1.830, 1.019, 0.6578, 0.3656, 0.2571, 0.1674),
    "Ti": (4.972, 2.214, 1.213, 0.7661, 0.4052, 0.2721, 0.1649),
    "Cr": (6.434, 2.856, 1.550, 0.9639, 0.4905, 0.3166, 0.1788),
    "Fe": (8.176, 3.629, 1.958, 1.205, 0.5952, 0.3717, 0.1964),
    "Ni": (10.34, 4.600, 2.474, 1.512, 0.7306, 0.4440, 0.2208),
    "Cu": (10.92, 4.862, 2.613, 1.593, 0.7630, 0.4584, 0.2217),
    "Zn": (12.07, 5.384, 2.892, 1.760, 0.8364, 0.4973, 0.2341),
    "water": (0.3756, 0.2683, 0.2269, 0.2059, 0.1837, 0.1707, 0.1505),
    "PMMA": (0.3032, 0.2350, 0.2074, 0.1924, 0.1751, 0.1641, 0.1456),
    "cortical bone": (1.331, 0.6655, 0.4242, 0.3148, 0.2229, 0.1855, 0.1480),
    "skeletal muscle": (0.3783, 0.2685, 0.2262, 0.2048, 0.1823, 0.1693, 0.1492),
}
"""At `TABLE_ENERGIES_KEV`: elements, and mixtures as NIST defines them."""


@dataclass(frozen=True)
class Material:
    """A material: its density, g/cm3, and the parts of its mass, by name in the table."""

    density: float
    parts: Mapping[str, float]


WATER = Material(1.0, {"water": 1.0})
GEL = Material(1.04, {"water": 1.0})
MUSCLE = Material(1.05, {"skeletal muscle": 1.0})
BONE = Material(1.92, {"cortical bone": 1.0})
PMMA = Material(1.19, {"PMMA": 1.0})
GLASS = Material(2.5, {"O": 0.46, "Na": 0.10, "Si": 0.34, "Ca": 0.10})
CERAMIC = Material(3.9, {"Al": 0.53, "O": 0.47})
ALUMINIUM = Material(2.70, {"Al": 1.0})
TITANIUM = Material(4.51, {"Ti": 1.0})
STEEL = Material(7.9, {"Fe": 0.71, "Cr": 0.19, "Ni": 0.10})
BRASS = Material(8.5, {"Cu": 0.63, "Zn": 0.37})


def attenuation(material: Material, energies_kev: Floats) -> Floats:
    """Return the attenuation of a material (E,) at energies (E,) of 30 to 150 keV, 1/mm."""
    table = sum(part * np.array(MASS_ATTENUATION_CM2_PER_G[name]) for name, part in material.parts.items())
    mass = np.exp(np.interp(np.log(energies_kev), np.log(TABLE_ENERGIES_KEV), np.log(table)))
    per_mm: Floats = material.density * mass / 10
    return per_mm


@dataclass(frozen=True)
class Spectrum:
    """A spectrum as the detector weighs it: `energies_kev` (E,), and `weights` (E,) with the sum 1."""

    energies_kev: Floats
    weights: Floats


FILTER_MM = 8.0
"""Aluminium, mm, that filters the beam as much as tube and housing do."""

CHARACTERISTIC_LINES = {59.0: 0.12, 67.5: 0.04}
"""K lines of tungsten, keV, and how many photons each adds, in parts of the continuous spectrum."""

BIN_KEV = 10.0


def tungsten_spectrum(tube_kv: float) -> Spectrum:
    """Return the spectrum of a tungsten tube: Kramers' law behind aluminium, and the K lines.

    The detector integrates energy.
    """
    edges = np.arange(30.0, tube_kv + 1e-9, BIN_KEV)
    energies = (edges[:-1] + edges[1:]) / 2
    photons = (tube_kv / energies - 1) * np.exp(-FILTER_MM * attenuation(ALUMINIUM, energies))
    total = photons.sum()
    for line, part in CHARACTERISTIC_LINES.items():
        photons[np.searchsorted(edges, line) - 1] += part * total
    weights = photons * energies
    return Spectrum(energies, weights / weights.sum())
