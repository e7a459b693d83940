"""Define the phantoms of the twin: 80 mm boxes of layers, in a world whose x axis points into the box.

The layers' places are invented; that they are planes, and in phantoms 2 and 3 a cylinder, is the paper's.
The needle enters through the face x = 0, -40 <= y, z <= 40. The stages lie in the xy plane, tilts turn
the phantom about z, and z says at which height the needle enters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from needlefit.geometry.surfaces import Surface, make_cylinder, make_sheet

BOX_MM = 80.0
"""Edge of the box, mm."""


@dataclass(frozen=True)
class Cylinder:
    """The solid in place of the prostate: a cylinder along y at height z = 0; it is layer 4.

    Attributes
    ----------
    top : float
        x of the line at which it comes closest to the entry face, mm.
    radius, length : float
        mm.
    """

    top: float
    radius: float
    length: float


@dataclass(frozen=True)
class Phantom:
    """A box with plane interfaces at `interfaces` (x, mm; the n-th leads into layer n + 1) and a cylinder."""

    interfaces: tuple[float, ...]
    cylinder: Cylinder | None = None

    @property
    def boundaries(self) -> int:
        """Number of boundaries."""
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
    """Return the file name of a surface of a medium."""
    return f"layers/{medium}_{surface.name}.stl"
