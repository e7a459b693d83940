"""Images of a scan in the axes of the constraint frame, with the reconstruction drawn over them."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from needlefit.geometry.crossings import find_surface_hits
from needlefit.geometry.curves import interpolate_at_arc
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.constants import HU
from needlefit.imaging.reconstruction import Reconstruction, ScanView
from needlefit.reporting.labels import METHOD_COLOURS

Floats = NDArray[np.float64]

NEEDLE_COLOUR = METHOD_COLOURS["fitted"]
ENTRY_COLOUR = "#E69F00"
LAYER_COLOUR = "#56B4E9"
TIP_COLOUR = "#C8102E"
MARKER_COLOUR = "#009E73"

_MAX_SHEET_DISTANCE_MM = 3.0  # mm: a marker's centre may lie so far from the slab that it is drawn over
_OUTLINE_STEP_MM = 0.6  # mm between the dots of a layer's outline
_MIN_WINDOW_HU = 250.0  # HU
_OUTSIDE_COLOUR = "#e6ecf2"  # of the volume: no grey of the scan


def show_slab(axes: Axes, view: ScanView, views: Sequence[ScanView], span: tuple[float, float]) -> None:
    """Draw one image of several, which share their greys; `span` is its vertical range, mm."""
    brightness, shade = _choose_window(views)
    axes.set_facecolor(_OUTSIDE_COLOUR)
    axes.imshow(
        np.interp(view.values, brightness, shade), cmap="gray", vmin=0, vmax=1, extent=view.extent,
        origin="lower", interpolation="nearest", aspect="equal",
    )  # fmt: skip
    axes.set(xlim=view.extent[:2], ylim=span)
    axes.yaxis.set_major_locator(MultipleLocator(5))
    for spine in axes.spines.values():
        spine.set_visible(False)


def join_needle(reconstruction: Reconstruction) -> Floats:
    """Return the whole needle from base to tip in C: (N, 3), mm."""
    placed = reconstruction.patient.to_world(reconstruction.needle_axis.points)
    return reconstruction.frame.to_local(placed)


def _choose_window(views: Sequence[ScanView]) -> tuple[Floats, Floats]:
    """Return brightnesses, HU, increasing, and how light each is drawn, 0 to 1.

    Tissue and its layers take most of the greys; air and metal share the rest, so that their edges stay where
    they are. Metal and its bloom are bright whatever the tissue is: the brighter tenth does not count.
    """
    shown = np.concatenate([view.values[np.isfinite(view.values)] for view in views])
    tissue = shown[shown > HU.LIGHT]
    if tissue.size == 0:
        return np.array([-1000.0, 3000.0]), np.array([0.0, 1.0])
    low, middle, high = np.quantile(tissue, (0.03, 0.5, 0.9))
    room = max(_MIN_WINDOW_HU, 1.5 * (high - low)) / 2
    low, high = min(low, middle - room), max(high, middle + room)
    return np.array([-1000.0, low, high, max(3000.0, high + 1.0)]), np.array([0.0, 0.25, 0.75, 1.0])


def draw_reconstruction(
    axes: Axes, view: ScanView, reconstruction: Reconstruction, span: tuple[float, float]
) -> None:
    """Draw needle, layers and markers nearby over an image; `span` is its vertical range, mm."""
    for surface in reconstruction.layers.surfaces:
        dots = outline_surface(view, reconstruction, surface, span)
        axes.plot(*dots.T, ".", color=LAYER_COLOUR, ms=1.9, mew=0, zorder=3)
    up = "xyz".index(view.axes[1])
    whole, inserted = join_needle(reconstruction), reconstruction.local
    crossed = reconstruction.frame.to_local(reconstruction.layers.points)
    outside = whole[whole[:, 0] <= 0]
    axes.plot(*outside[:, [0, up]].T, color=NEEDLE_COLOUR, lw=0.6, ls=(0, (4, 2)))
    axes.plot(*inserted[:, [0, up]].T, color=NEEDLE_COLOUR, lw=0.6)
    for points, colour in (
        (inserted[:1], ENTRY_COLOUR),
        (inserted[-1:], TIP_COLOUR),
        (crossed, LAYER_COLOUR),
    ):
        axes.plot(*points[:, [0, up]].T, "o", color=colour, ms=2.6, mec="white", mew=0.3, zorder=5)
    if reconstruction.markers is None:
        return
    centers = reconstruction.frame.to_local(reconstruction.patient.to_world(reconstruction.markers.centers))
    middle = np.interp(centers[:, 0], whole[:, 0], whole[:, 3 - up])
    near = np.abs(centers[:, 3 - up] - middle) <= _MAX_SHEET_DISTANCE_MM
    # the centre alone: the slab cuts a ball off its middle, where a ring of its size would not be its outline
    axes.plot(*centers[near][:, [0, up]].T, "+", color=MARKER_COLOUR, mew=1.0, ms=6)


def outline_surface(
    view: ScanView, reconstruction: Reconstruction, surface: Surface, span: tuple[float, float]
) -> Floats:
    """Return the line along which the image plane of the needle cuts a surface: points (K, 2), mm.

    The sheet follows the needle along its third axis; so it is swept by the needle's course shifted
    sideways, and cuts the surface where those curves do.
    """
    up = "xyz".index(view.axes[1])
    needle = join_needle(reconstruction)
    x = np.arange(max(0.0, view.extent[0]), view.extent[1], 2.0)
    course = np.column_stack([x, *(np.interp(x, needle[:, 0], side) for side in needle.T[1:])])
    cuts = []
    for level in np.arange(*span, _OUTLINE_STEP_MM):
        course[:, up] = level
        path = reconstruction.frame.to_world(course)
        hits = interpolate_at_arc(path, find_surface_hits(path, surface)).reshape(-1, 3)
        cuts.append(reconstruction.frame.to_local(hits)[:, [0, up]])
    return np.concatenate(cuts) if cuts else np.empty((0, 2))
