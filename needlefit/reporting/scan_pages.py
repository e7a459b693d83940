"""Pages of a scan, for a quick visual check: of a reconstructed one, and of one that was refused."""

import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from needlefit.arrays import Floats
from needlefit.geometry.crossings import find_surface_hits
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.batch import ReconstructionFailure
from needlefit.imaging.constants import HU
from needlefit.imaging.reconstruction import CurvePicture, Reconstruction, ScanView
from needlefit.imaging.scans import Scan
from needlefit.inference.identifiability.directions import NORMAL_95_HALF_WIDTH_SD
from needlefit.project.folders import replace_file
from needlefit.reporting import document
from needlefit.reporting.figures.style import MM_PER_INCH, draw, draw_grid, set_margins, spread_labels
from needlefit.reporting.labels import GREY, INK, METHOD_COLOURS, medium_name
from needlefit.schemas.origin import ORIGIN_MARKS

Fact = tuple[str, str]

MAX_LISTED_WARNINGS = 10  # largest number of warnings on a page; the table of the batch has all of them
_CAPTION = (
    "The scan in slabs that follow the needle (crosses: markers nearby); below, its deflection and the "
    "brightness around it (shaded: air, soft, metal; yellow: guide). Lines: entry, layers, tip. Bands: "
    "pointwise 95 %."
)
_REFUSED_CAPTION = (
    "The scan in slabs that follow what was taken for the needle (line); across it, by numbers: the answers."
)


def write_quality(reconstruction: Reconstruction, facts: list[Fact], path: Path) -> Path:
    """Write the quality page (A4, PDF), completely or not at all; equal reconstructions give equal bytes.

    `facts`: names and numbers beside the picture.

    ConfigError if nothing can be written there.
    """
    warnings = list(reconstruction.warnings[:MAX_LISTED_WARNINGS])
    if left := len(reconstruction.warnings) - len(warnings):
        warnings.append(f"and {left} more, in reconstruction.csv")
    words = (f"Reconstruction of {reconstruction.scan.id}", facts, warnings, _CAPTION)
    return _write_page(path, reconstruction.scan, words, partial(paint_needle_section, reconstruction))


def write_refusal_page(failure: ReconstructionFailure, path: Path) -> None:
    """Write the page of a refused scan (A4, PDF): why, and what was taken for the needle; none without it."""
    if failure.picture is None:
        return
    error = failure.error
    facts = [(name, text) for name in ("where", "expected", "fix") if (text := getattr(error, name))]
    words = (f"{failure.scan.id} was refused", facts, [error.what, *failure.warnings], _REFUSED_CAPTION)
    path.parent.mkdir(exist_ok=True)
    _write_page(path, failure.scan, words, partial(paint_refusal, failure.picture))


def _write_page(
    path: Path, scan: Scan, words: tuple[str, list[Fact], list[str], str], paint: Callable[[], Figure]
) -> Path:
    """Write a page (A4, PDF) with a picture, completely or not at all.

    `words`: title, facts, warnings, and the caption of the picture.
    """
    title, facts, warnings, caption = words
    summary = [medium_name(scan.medium), scan.specimen, scan.volume.name]
    payload: document.Block = {
        "title": title,
        "subtitle": " · ".join(word for word in summary if word),
        "origin_mark": ORIGIN_MARKS[scan.origin],
        "version": document.find_version(),
        "facts": facts,
        "warnings": warnings,
        "caption": caption,
    }
    with tempfile.TemporaryDirectory(prefix="needlefit-") as name:
        picture = draw(Path(name, "picture.pdf"), paint)
        page = document.compile_template("quality.typ", payload, {"picture.pdf": picture})
    with replace_file(path) as new:
        new.write_bytes(page)
    return path


# ---- the picture

Span = tuple[float, float]
Mark = tuple[float, float, str, str]  # place along x and its deviation, mm; colour and name

NEEDLE_SECTION_WIDTH_MM = 180.0  # width of the figure (mm)
NEEDLE_SECTION_HEIGHT_MM = 175.0  # height of the figure (mm)
OUT_OF_PLANE_COLOUR = "#D55E00"
_LEFT_MM = 17.0  # margin left of the panels (mm)
_RIGHT_MM = 1.0  # margin right of the panels (mm)
_TOP_MM = 4.0  # margin above the panels (mm)
_BOTTOM_MM = 11.0  # margin below the panels (mm)
_PANEL_GAP_MM = 2.5  # gap between panels (mm)
_MATERIAL_COLOURS = {"air": "#dfe7ef", "soft": "#f3dcc3", "metal": "#5b6470"}
GUIDE_COLOUR = "#F0E442"
_PLOT_HEIGHT_MM = 30.0  # height (mm) of the plots of deflection and of brightness


def paint_needle_section(reconstruction: Reconstruction) -> Figure:
    """Draw images, deflection and brightness over the same axis, x of the constraint frame."""
    layers, tip = reconstruction.layers, reconstruction.local[-1, 0]
    marks = [(0.0, reconstruction.pose.along_sd, ENTRY_COLOUR, "entry")]
    for n, (depth, sd) in enumerate(zip(layers.boundaries, layers.sd, strict=True)):
        names = " → ".join(map(str, layers.sequence[n : n + 2]))
        marks.append((float(depth), float(sd), LAYER_COLOUR, names))
    marks.append((float(tip), float(reconstruction.needle_axis.end.sd[0]), TIP_COLOUR, "tip"))

    def overlay(axes: Axes, view: ScanView, span: Span) -> None:
        draw_reconstruction(axes, view, reconstruction, span)
        axes.set_ylabel(f"{'xyz'[view.up]} in C\n(mm)")

    plots = [
        partial(paint, reconstruction=reconstruction) for paint in (_paint_deflection, _paint_brightness)
    ]
    label = "x along the entry axis (mm)"
    return _paint_panels(reconstruction.views, join_needle(reconstruction), marks, label, overlay, plots)


def paint_refusal(picture: CurvePicture) -> Figure:
    """Draw the scan in two directions across a curve, and the curve, x along it."""

    def overlay(axes: Axes, view: ScanView, _span: Span) -> None:
        axes.plot(*picture.curve[:, [0, view.up]].T, color=NEEDLE_COLOUR, lw=0.6)
        axes.set_ylabel("across (mm)")

    marks = [(x, 0.0, ENTRY_COLOUR, f"{n}") for n, x in enumerate(picture.entries.tolist(), start=1)]
    label = "along what was taken for the needle (mm)"
    return _paint_panels(picture.views, picture.curve, marks, label, overlay)


def _paint_panels(
    views: Sequence[ScanView],
    curve: Floats,
    marks: Sequence[Mark],
    label: str,
    overlay: Callable[[Axes, ScanView, Span], None],
    plots: Sequence[Callable[[Axes], None]] = (),
) -> Figure:
    """Draw images of a scan, and plots below, over the same x; lines through all of them mark places on it.

    `curve`: (N, 3); what the images follow, in their frame, mm.
    `overlay`: draws over an image, of this vertical range.
    """
    width = NEEDLE_SECTION_WIDTH_MM - _LEFT_MM - _RIGHT_MM
    left, right = views[0].extent[:2]
    scale = width / (right - left)  # mm on paper per mm
    taken = (
        _TOP_MM + _BOTTOM_MM + len(plots) * _PLOT_HEIGHT_MM + _PANEL_GAP_MM * (len(views) + len(plots) - 1)
    )
    spans = choose_spans(views, curve, (NEEDLE_SECTION_HEIGHT_MM - taken) / scale)
    heights = [*(scale * (high - low) for low, high in spans), *len(plots) * [_PLOT_HEIGHT_MM]]
    figure = Figure(figsize=(NEEDLE_SECTION_WIDTH_MM / MM_PER_INCH, NEEDLE_SECTION_HEIGHT_MM / MM_PER_INCH))
    panels = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    below = NEEDLE_SECTION_HEIGHT_MM - _TOP_MM - sum(heights) - _PANEL_GAP_MM * (len(heights) - 1)
    edges = {"left": _LEFT_MM, "top": _TOP_MM, "right": _RIGHT_MM, "bottom": below}
    gap = _PANEL_GAP_MM / MM_PER_INCH
    inches = {edge: margin / MM_PER_INCH for edge, margin in edges.items()}
    set_margins(figure, gaps=(gap, gap), **inches)
    for axes, view, span in zip(panels, views, spans, strict=False):
        show_slab(axes, view, views, span)
        overlay(axes, view, span)
    for axes, plot in zip(panels[len(views) :], plots, strict=True):
        plot(axes)
        axes.set_xlim(left, right)
        for x, sd, colour, _ in marks:
            half = NORMAL_95_HALF_WIDTH_SD * sd
            axes.axvspan(x - half, x + half, color=colour, alpha=0.3, lw=0, zorder=0)
    for axes in panels:
        for x, _, colour, _ in marks:
            axes.axvline(x, color=colour, lw=0.6, zorder=1.5)
        axes.yaxis.set_label_coords(-10.0 / width, 0.5)
        axes.tick_params(labelbottom=axes is panels[-1])
    panels[-1].set_xlabel(label)
    _name_marks(panels[0], marks, scale)
    return figure


def choose_spans(pictures: Sequence[ScanView], needle: Floats, room: float) -> list[Span]:
    """Return the vertical range of each image so that together they are at most `room` mm high, the needle in
    the middle.
    """
    centres, reaches = [], []
    for view in pictures:
        left, right, bottom, top = view.extent
        part = needle[(needle[:, 0] >= left) & (needle[:, 0] <= right), view.up]
        centres.append(float(part.min() + part.max()) / 2)
        reaches.append((top - bottom) / 2)
    share = min(1.0, room / (2 * sum(reaches)))
    return [(c - share * reach, c + share * reach) for c, reach in zip(centres, reaches, strict=True)]


def _paint_brightness(axes: Axes, reconstruction: Reconstruction) -> None:
    """Draw the brightness around the needle, and what it passes, over x in C; straight on beyond the tip."""
    profile = reconstruction.profile
    for run in reconstruction.passed:
        guided = reconstruction.name_part(run) == "guide"
        colour = GUIDE_COLOUR if guided else _MATERIAL_COLOURS[run.kind]
        ends = _place_along(reconstruction, np.array([run.begin, run.end]))
        axes.axvspan(*ends, facecolor=colour, edgecolor="white", lw=0.6, alpha=0.6, zorder=0)
    axes.plot(_place_along(reconstruction, profile.s), profile.around, color=INK, lw=0.9)
    axes.set_ylabel("surroundings\n(HU)")
    draw_grid(axes)


def _place_along(reconstruction: Reconstruction, s: Floats) -> Floats:
    """Return x in C of places along the needle, mm from its first point; straight on beyond its ends."""
    points = join_needle(reconstruction)
    along = arc_length(points)
    beyond = np.clip(s - along[-1], 0, None) + np.clip(s, None, 0)
    return np.interp(s, along, points[:, 0]) + beyond


def _paint_deflection(axes: Axes, reconstruction: Reconstruction) -> None:
    x, y, z = reconstruction.local.T
    half = NORMAL_95_HALF_WIDTH_SD * reconstruction.sd
    for side, colour, words in (
        (z, OUT_OF_PLANE_COLOUR, "out of plane, z"),
        (y, NEEDLE_COLOUR, "deflection, y"),
    ):
        axes.fill_between(x, side - half, side + half, color=colour, alpha=0.3, lw=0)
        axes.plot(x, side, color=colour, lw=1.1, label=words)
    axes.axhline(0.0, color=GREY, lw=0.5, zorder=1)
    axes.set_ylabel("in C\n(mm)")
    axes.legend(
        loc="upper left", handlelength=1.3, fontsize=7, borderaxespad=0.2, reverse=True,
        frameon=True, facecolor="white", edgecolor="none", framealpha=1.0, borderpad=0.15,
    )  # fmt: skip
    draw_grid(axes)


def _name_marks(axes: Axes, marks: Sequence[Mark], scale: float) -> None:
    """Write over the first panel what the lines through all are, and where the base lies.

    `scale`: mm on paper per mm.
    """
    left, top = axes.get_xlim()[0], axes.get_ylim()[1]
    stand = spread_labels([x for x, *_ in marks], [name for *_, name in marks], scale)
    for (x, _, colour, name), over in zip(marks, stand, strict=True):
        axes.plot([x, x], [top, top], "v", color=colour, ms=3.2, mew=0, clip_on=False, zorder=6)
        _write_over(axes, name, (over, top), "center")
    _write_over(axes, "← base", (left, top), "left")


def _write_over(axes: Axes, text: str, place: tuple[float, float], align: str) -> None:
    axes.annotate(
        text, place, xytext=(0, 2.5), textcoords="offset points", ha=align, va="bottom",
        fontsize=7, color=INK, annotation_clip=False,
    )  # fmt: skip


# ---- views of scans

NEEDLE_COLOUR = METHOD_COLOURS["fitted"]
ENTRY_COLOUR = "#E69F00"
LAYER_COLOUR = "#56B4E9"
TIP_COLOUR = "#C8102E"
MARKER_COLOUR = "#009E73"

_MAX_SHEET_DISTANCE_MM = 3.0  # largest distance (mm) of a marker's centre from a slab over which it is drawn
_OUTLINE_STEP_MM = 0.6  # distance (mm) between the dots of a layer's outline
_MIN_WINDOW_HU = 250.0  # smallest width (HU) of the range of tissue that is shown in contrast
_OUTSIDE_COLOUR = "#e6ecf2"  # colour outside of the volume: no grey of the scan


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
    return reconstruction.frame.to_local(reconstruction.whole_needle)


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
    up = view.up
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
    up = view.up
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
