"""Pages of a scan, for a quick visual check: of a reconstructed one, and of one that was refused."""

import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from needlefit.arrays import Floats
from needlefit.errors import NeedlefitError
from needlefit.geometry.curves import arc_length
from needlefit.imaging.batch import Findings, ReconstructionFailure
from needlefit.imaging.reconstruction import TIP_SECTION_OFFSET_MM, Reconstruction, ScanView
from needlefit.imaging.scans import Scan
from needlefit.imaging.volume import VoxelGrid, to_index
from needlefit.project.folders import replace_file
from needlefit.reporting import document
from needlefit.reporting.figures.scan_views import (
    ENTRY_COLOUR,
    LAYER_COLOUR,
    MARKER_COLOUR,
    NEEDLE_COLOUR,
    TIP_COLOUR,
    join_needle,
    show_view,
)
from needlefit.reporting.figures.style import add_panel_mm, draw, draw_grid, make_figure_mm, spread_labels
from needlefit.reporting.labels import GREY, INK, medium_name
from needlefit.reporting.number_format import format_mm

Fact = tuple[str, str]
Paint = Callable[[], Figure]
#: title, facts in groups, warnings, and the captions of the pictures
Words = tuple[str, list[list[Fact]], list[str], tuple[str, str]]

MAX_LISTED_WARNINGS = 10  # number of warnings on a page; the table of the batch has all of them
_QUALITY_CAPTIONS = (
    "Above, the scan in slabs that follow the needle (crosses: centres of markers nearby); below, "
    "brightness, deflection, cross-sections off the axis. Lines: entry, layers, tip. Bands: 95 %, "
    "of the axis, not of single sections.",
    "The scan across the needle near its tip, and the markers' distances from their known places.",
)
_REFUSED_CAPTIONS = (
    "Largest brightness through the scan, along j and along i; lines: tubes (bold: taken as the needle); "
    "circles: balls (filled: markers). Below, brightness along the needle; lines: where soft material "
    "begins.",
    "Largest brightness through the scan, along k.",
)
_SOURCES = {
    **{"stage": "the stage", "shaft": "the straight shaft outside"},
    **{"stated": "the stated bevel", "bevel": "the bevel in the scan", "shape": "the needle's shape"},
    **{"volume": "found in the scan", "fiducials": "placed by hand"},
}


def write_quality(one: Reconstruction, path: Path) -> Path:
    """Write the quality page (A4, PDF), completely or not at all; equal reconstructions give equal bytes.

    ConfigError if nothing can be written there.
    """
    warnings, left = list(one.warnings[:MAX_LISTED_WARNINGS]), len(one.warnings) - MAX_LISTED_WARNINGS
    warnings += [f"and {left} more, in reconstruction.csv"] * (left > 0)
    words = (f"Reconstruction of {one.scan.id}", list_facts(one), warnings, _QUALITY_CAPTIONS)
    pictures = (partial(paint_needle_section, one), partial(paint_tip_section, one))
    return _write_page(path, one.scan, words, pictures)


def write_refused_pages(failures: Sequence[ReconstructionFailure], folder: Path) -> None:
    """Write `<id>.pdf` (A4) of each refused scan into a folder, with everything that was found in it.

    ConfigError if nothing can be written there.
    """
    folder.mkdir(exist_ok=True)
    for failure in failures:
        scan, found = failure.scan, failure.findings
        facts = [[("scan", "could not be read")]] if found is None else list_finding_facts(found)
        words = (f"Refused: {scan.id}", facts, list_reasons(failure.error), _REFUSED_CAPTIONS)
        pictures = (partial(paint_along, found), partial(paint_across, found))
        _write_page(folder / f"{scan.id}.pdf", scan, words, pictures)


def _write_page(path: Path, scan: Scan, words: Words, pictures: Sequence[Paint]) -> Path:
    """Write a page with two pictures of a scan (A4, PDF), completely or not at all."""
    title, facts, warnings, captions = words
    summary = [medium_name(scan.medium), scan.specimen, scan.volume.name]
    payload: document.Block = {
        "title": title,
        "subtitle": " · ".join(word for word in summary if word),
        "synthetic": scan.origin == "synthetic",
        "mark": "SYNTHETIC DATA",
        "version": document.find_version(),
        "groups": facts,
        "warnings": [warning.replace("+-", "±") for warning in warnings],
        "caption": captions[0],
        "along": captions[0],
        "across": captions[1],
    }
    with tempfile.TemporaryDirectory(prefix="needlefit-") as name:
        files = [Path(name, "along.pdf"), Path(name, "across.pdf")]
        drawn = [draw(file, paint) for file, paint in zip(files, pictures, strict=True)]
        page = document.compile_template("quality.typ", payload, {one.name: one for one in drawn})
    with replace_file(path) as new:
        new.write_bytes(page)
    return path


def list_facts(one: Reconstruction) -> list[list[Fact]]:
    """Return the facts and numbers of the page of a reconstruction, in groups."""
    spacing, pose, off = one.spacing, one.pose, one.local[:, 2]
    same = np.ptp(spacing) < 5e-4
    edges = f"{spacing[0]:.3g}" if same else " × ".join(f"{edge:.3g}" for edge in spacing)
    across = f"± {format_mm(pose.shift_sd)} mm and ± {format_mm(np.degrees(pose.angle_sd))}° across"
    along_sd, across_sd = one.needle_axis.tip_sd
    most = format_mm(float(np.abs(off).max()))
    layers = list[Fact]()
    for n, (depth, sd) in enumerate(zip(one.layers.boundaries, one.layers.sd, strict=True)):
        before, after = one.layers.sequence[n : n + 2]
        words = f"{before} → {after} at {_with_sd(float(depth), float(sd))}"
        layers.append(("" if n else "layers", words))
    registered = [("world", "the patient frame (LPS) of the scan; no markers")]
    if one.markers is not None and (fit := one.registration) is not None:
        paired, count, (entry, tip) = (
            len(fit.pairs),
            len(one.markers.centers),
            map(format_mm, one.target_error),
        )
        more = f"; {count - paired} more belong to none" if count > paired else ""
        registered = [
            ("markers", f"{paired} of {fit.known} {_SOURCES[one.markers.source]}{more}"),
            ("registration", f"FRE {format_mm(fit.fre)} mm; {format_mm(fit.expected_fre)} expected"),
            ("error it leaves", f"{entry} mm at the entry, {tip} at the tip, predicted"),
        ]
    return [
        [("voxels", f"{edges} mm" + (", cubes" if same else ""))],
        registered,
        [
            ("entry pose", f"from {_SOURCES[pose.source]}"),
            ("", f"± {format_mm(pose.along_sd)} mm along, {across}"),
            ("bending plane", f"from {_SOURCES[one.plane]}"),
            ("out of plane", f"{format_mm(_rms(off))} mm (rms), {most} mm at most"),
        ],
        [
            ("inserted length", _with_sd(one.depth, one.depth_sd)),
            ("tip's deflection", f"{format_mm(one.deflection)} mm"),
            ("tip", f"± {format_mm(along_sd)} mm along, ± {format_mm(across_sd)} mm across"),
            ("centreline", f"± {_rms(one.sd):.3f} mm across (rms)"),
        ],
        layers or [("layers", "no boundary crossed")],
    ]


def list_finding_facts(found: Findings) -> list[list[Fact]]:
    """Return the facts of the page of a refused scan, in groups."""
    spacing = " × ".join(f"{edge:.3g}" for edge in found.grid.spacing)
    size = " × ".join(str(count) for count in found.grid.size)
    tubes, balls, entries = list[Fact](), list[Fact](), list[Fact]()
    for n, tube in enumerate(found.tubes, start=1):
        first, last = (_place(end) for end in tube.ends)
        words = f"{tube.length:.1f} mm long, {tube.width:.1f} wide; L, P, S {first} to {last}"
        tubes.append((f"tube {n}" + " (needle)" * tube.chosen, words))
    for n, ball in enumerate(found.balls, start=1):
        words = f"{ball.diameter:.1f} mm; L, P, S {_place(ball.center)}"
        balls.append((f"ball {n}" + " (marker)" * ball.marker, words))
    for n, one in enumerate(found.entries, start=1):
        words = f"{one.depth:.2f} ± {one.sd:.2f} mm before the tip, {one.run.level:.0f} HU"
        entries.append((f"entry {n}", words))
    return [
        [("voxels", f"{size}, {spacing} mm")],
        tubes or [("tubes", "none")],
        balls or [("balls", "none found, or none needed")],
        entries or [("entry", "not looked for: no needle" if found.needle is None else "none")],
    ]


def _place(at: Floats) -> str:
    return ", ".join(f"{x:.0f}" for x in at)


def _with_sd(value: float, sd: float) -> str:
    return f"{format_mm(value)} ± {format_mm(sd)} mm"


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def list_reasons(error: NeedlefitError) -> list[str]:
    """Return the parts of an error, each in words."""
    named = {"where": error.where, "expected": error.expected, "fix": error.fix}
    return [f"refused: {error.what}", *(f"{name}: {text}" for name, text in named.items() if text)]


# ---- the pictures

Span = tuple[float, float]

NEEDLE_SECTION_WIDTH_MM, NEEDLE_SECTION_HEIGHT_MM = 180.0, 175.0  # of the figure, mm
OUT_OF_PLANE_COLOUR = "#D55E00"
# mm around and between the panels
_LEFT_MM, _RIGHT_MM, _TOP_MM, _BOTTOM_MM, _PANEL_GAP_MM = 17.0, 1.0, 4.0, 8.0, 2.5
_PLOT_HEIGHTS_MM = {"core": 9.0, "around": 24.0, "deflection": 24.0, "residuals": 20.0}  # heights, mm
_NORMAL_95_HALF_WIDTH_SD = 1.96


def paint_needle_section(reconstruction: Reconstruction) -> Figure:
    """Draw image, brightness, deflection and residuals over the same axis, x of the constraint frame."""
    figure = make_figure_mm(NEEDLE_SECTION_WIDTH_MM, NEEDLE_SECTION_HEIGHT_MM)
    pictures = [view for view in reconstruction.views if view.axes[0] == "x"]
    width = NEEDLE_SECTION_WIDTH_MM - _LEFT_MM - _RIGHT_MM
    left, right = pictures[0].extent[:2]
    scale = width / (right - left)  # mm on paper per mm
    gaps = _PANEL_GAP_MM * (len(_PLOT_HEIGHTS_MM) + len(pictures) - 1)
    taken = _TOP_MM + _BOTTOM_MM + sum(_PLOT_HEIGHTS_MM.values()) + gaps
    shown = choose_spans(pictures, join_needle(reconstruction), (NEEDLE_SECTION_HEIGHT_MM - taken) / scale)
    top = NEEDLE_SECTION_HEIGHT_MM - _TOP_MM
    panels: list[Axes] = []
    for view, span in zip(pictures, shown, strict=True):
        height = scale * (span[1] - span[0])
        panels.append(add_panel_mm(figure, (_LEFT_MM, top - height, width, height)))
        show_view(panels[-1], view, reconstruction, span)
        panels[-1].set_ylabel(f"{view.axes[1]} in C\n(mm)")
        top -= height + _PANEL_GAP_MM
    for name, height in _PLOT_HEIGHTS_MM.items():
        panels.append(add_panel_mm(figure, (_LEFT_MM, top - height, width, height)))
        _PAINTERS[name](panels[-1], reconstruction)
        panels[-1].set_xlim(left, right)
        for at, sd, colour, _ in _marked_depths(reconstruction):
            half = _NORMAL_95_HALF_WIDTH_SD * sd
            panels[-1].axvspan(at - half, at + half, color=colour, alpha=0.3, lw=0, zorder=0)
            panels[-1].axvline(at, color=colour, lw=0.7, zorder=1)
        top -= height + _PANEL_GAP_MM
    for axes in panels[:-1]:
        axes.tick_params(labelbottom=False)
    panels[-1].set_xlabel("x along the entry axis (mm)")
    _name_depths(panels[0], reconstruction)
    for axes in panels:
        axes.yaxis.set_label_coords(-10.0 / width, 0.5)
    return figure


def choose_spans(pictures: Sequence[ScanView], needle: Floats, room: float) -> list[Span]:
    """Return the vertical range of each image so that together they are at most `room` mm high, the needle in
    the middle.
    """
    centres, reaches = [], []
    for view in pictures:
        left, right, bottom, top = view.extent
        part = needle[(needle[:, 0] >= left) & (needle[:, 0] <= right), "xyz".index(view.axes[1])]
        centres.append(float(part.min() + part.max()) / 2)
        reaches.append((top - bottom) / 2)
    share = min(1.0, room / (2 * sum(reaches)))
    return [(c - share * reach, c + share * reach) for c, reach in zip(centres, reaches, strict=True)]


def _paint_brightness(axes: Axes, reconstruction: Reconstruction, which: str, name: str) -> None:
    profile = reconstruction.profile
    axes.plot(_arc_to_x(reconstruction, profile.s), getattr(profile, which), color=INK, lw=0.9)
    axes.set_ylabel(f"{name}\n(HU)")
    if which == "core":
        axes.yaxis.set_major_locator(MaxNLocator(2))
    else:
        draw_grid(axes, "y")


def _paint_deflection(axes: Axes, reconstruction: Reconstruction) -> None:
    x, y, z = reconstruction.local.T
    half = _NORMAL_95_HALF_WIDTH_SD * reconstruction.sd
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
    draw_grid(axes, "y")


def _paint_residuals(axes: Axes, reconstruction: Reconstruction) -> None:
    needle_axis = reconstruction.needle_axis
    x = join_needle(reconstruction)[:, 0]
    turn = reconstruction.frame.rotation.T @ reconstruction.patient.rotation
    beside = needle_axis.residuals @ turn.T  # (S, 3), C
    at = np.interp(needle_axis.sections_s, arc_length(needle_axis.points), x)
    half = _NORMAL_95_HALF_WIDTH_SD * needle_axis.sd
    axes.fill_between(x, -half, half, color=GREY, alpha=0.3, lw=0, label="the axis, 95 %")
    for side, colour, mark, words in ((2, OUT_OF_PLANE_COLOUR, "D", "in z"), (1, NEEDLE_COLOUR, "o", "in y")):
        axes.plot(at, beside[:, side], mark, color=colour, ms=1.3, mew=0, label=words)
    axes.set_ylabel("sections off\naxis (mm)")
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.15 * (high - low), high + 0.3 * (high - low))  # room for the words
    axes.legend(
        loc="upper left", ncols=3, handlelength=1.0, handletextpad=0.4, columnspacing=1.2, fontsize=7,
        markerscale=2, borderaxespad=0.1, reverse=True,
    )  # fmt: skip
    _mark_tip_model(axes, float(at[-1]), float(x[-1]))
    draw_grid(axes, "y")


def _mark_tip_model(axes: Axes, last: float, tip: float) -> None:
    """Say why no cross-section stands near the tip: there a model is fitted whole."""
    across = axes.get_xaxis_transform()
    ends = {"arrowstyle": "|-|,widthA=0.15,widthB=0.15", "color": INK, "lw": 0.7, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (tip, 0.1), (last, 0.1), xycoords=across, arrowprops=ends, annotation_clip=False)
    axes.annotate(
        "fitted as\na whole", (tip, 0.04), xytext=(3, 0), xycoords=across, textcoords="offset points",
        fontsize=7, va="bottom", linespacing=0.95,
    )  # fmt: skip


_PAINTERS: dict[str, Callable[[Axes, Reconstruction], None]] = {
    "core": partial(_paint_brightness, which="core", name="needle"),
    "around": partial(_paint_brightness, which="around", name="surroundings"),
    "deflection": _paint_deflection,
    "residuals": _paint_residuals,
}


def _marked_depths(reconstruction: Reconstruction) -> list[tuple[float, float, str, str]]:
    """Return place along x, deviation, colour and name of the entry, each boundary and the tip."""
    layers, tip = reconstruction.layers, reconstruction.local[-1, 0]
    found = [(0.0, reconstruction.pose.along_sd, ENTRY_COLOUR, "entry")]
    for n, (depth, sd) in enumerate(zip(layers.boundaries, layers.sd, strict=True)):
        before, after = layers.sequence[n : n + 2]
        found.append((float(depth), float(sd), LAYER_COLOUR, f"{before} → {after}"))
    return [*found, (float(tip), float(reconstruction.needle_axis.tip_sd[0]), TIP_COLOUR, "tip")]


def _name_depths(axes: Axes, reconstruction: Reconstruction) -> None:
    """Write over the first panel what the lines through the others are, and where the base lies."""
    top = axes.get_ylim()[1]
    left, right = axes.get_xlim()
    depths = _marked_depths(reconstruction)
    stand = spread_labels(
        [at for at, *_ in depths],
        [name for *_, name in depths],
        (NEEDLE_SECTION_WIDTH_MM - _LEFT_MM - _RIGHT_MM) / (right - left),
    )
    for (at, _, colour, name), over in zip(depths, stand, strict=True):
        axes.annotate(
            name, (over, top), xytext=(0, 2.5), textcoords="offset points", ha="center", va="bottom",
            fontsize=7, color=INK, annotation_clip=False,
        )  # fmt: skip
        axes.plot([at, at], [top, top], "v", color=colour, ms=3.2, mew=0, clip_on=False, zorder=6)
    axes.annotate(
        "← base", (left, top), xytext=(0, 2.5), textcoords="offset points", va="bottom", fontsize=7,
    )  # fmt: skip


def _arc_to_x(reconstruction: Reconstruction, s: Floats) -> Floats:
    """Return x in C of places along the needle, `s` from its entry; straight on beyond the tip."""
    points = join_needle(reconstruction)
    along = arc_length(points)
    along += reconstruction.depth - along[-1]
    beyond = np.clip(s - along[-1], 0, None) + np.clip(s - along[0], None, 0)
    return np.asarray(np.interp(s, along, points[:, 0]) + beyond)


TIP_SECTION_WIDTH_MM = 86.0  # of the figure, mm
_MAX_MARKER_PANEL_MM = 40.0  # mm: height of the markers' panel at most


def paint_tip_section(reconstruction: Reconstruction) -> Figure:
    """Draw the image across the needle near its tip, and the markers' distances from known positions."""
    view = next(view for view in reconstruction.views if view.axes == ("y", "z"))
    left, right, bottom, top = view.extent
    width = 52.0
    height = width * (top - bottom) / (right - left)
    registration = reconstruction.registration
    rows = 0 if registration is None else len(registration.pairs)
    room = min(3.2 * rows, _MAX_MARKER_PANEL_MM)
    below = 15.0 + room if rows else 0.0
    total = height + 13.0 + below
    figure = make_figure_mm(TIP_SECTION_WIDTH_MM, total)
    axes = add_panel_mm(figure, (12.0, total - 5.0 - height, width, height))
    show_view(axes, view, reconstruction, (bottom, top))
    axes.set(xlabel="y in C (mm)", ylabel="z in C (mm)")
    axes.set_title(f"{TIP_SECTION_OFFSET_MM:g} mm before the tip", loc="left", pad=3)
    _point_bevel(axes, reconstruction)
    if rows:
        _paint_markers(add_panel_mm(figure, (12.0, 9.0, TIP_SECTION_WIDTH_MM - 13.0, room)), reconstruction)
    return figure


def _point_bevel(axes: Axes, reconstruction: Reconstruction) -> None:
    """Draw an arrow from the tip to the side of the bevel's point, where the scan shows it."""
    seen = reconstruction.patient.rotation @ reconstruction.needle_axis.bevel
    bevel = reconstruction.frame.rotation.T @ seen
    if not np.isfinite(bevel).all():
        return
    tip, side = reconstruction.local[-1, 1:], bevel[1:]
    (y, z), (far_y, far_z), (text_y, text_z) = tip, tip + 4.0 * side, tip + 4.4 * side
    at = "left" if side[0] >= 0 else "right"
    style = {"arrowstyle": "-|>", "color": TIP_COLOUR, "lw": 0.9, "mutation_scale": 6}
    style |= {"shrinkA": 2, "shrinkB": 0}
    axes.annotate("", (far_y, far_z), (y, z), arrowprops=style, zorder=6)
    axes.annotate("bevel", (text_y, text_z), color=TIP_COLOUR, fontsize=7, ha=at, va="center")


def _paint_markers(axes: Axes, reconstruction: Reconstruction) -> None:
    registration = reconstruction.registration
    assert registration is not None
    rows, order = np.arange(len(registration.pairs)), np.argsort(registration.pairs[:, 1])
    size = np.linalg.norm(registration.residuals[order], axis=1)
    left_out, expected = registration.leave_one_out[order], registration.expected_leave_one_out[order]
    axes.hlines(rows, 0.0, np.fmax(size, left_out), color=GREY, lw=0.5, zorder=1)
    axes.plot(size, rows, "o", color=MARKER_COLOUR, ms=3.2, mew=0, label="in the fit")
    axes.plot(left_out, rows, "o", mfc="white", mec=MARKER_COLOUR, mew=0.8, ms=3.2, label="left out")
    axes.plot(expected, rows, "|", color=INK, ms=7, mew=0.9, label="left out, expected")
    axes.set_yticks(rows, [f"{known}" for known in registration.pairs[order, 1]])
    axes.set(ylim=(len(rows) - 0.5, -0.5), ylabel="marker", xlabel="distance from its known place (mm)")
    axes.set_xlim(left=0.0)
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, handletextpad=0.1, columnspacing=1.0,
        fontsize=7, borderaxespad=0.1,
    )  # fmt: skip
    draw_grid(axes, "x")


_WINDOW_HU = (-700.0, 3000.0)
_ACROSS_MM, _VIEW_GAP_MM, _VIEW_LEFT_MM, _VIEW_BOTTOM_MM = 86.0, 10.0, 15.0, 9.0
_PROFILE_MM = 26.0
_MAX_VIEW_MM = 92.0
_AXES = "ijk"
# To the right and upwards, axes of the voxels, in each projection: along k, along j, along i.
_VIEWS: tuple[tuple[int, int], ...] = ((0, 1), (0, 2), (1, 2))


def paint_along(found: Findings | None) -> Figure:
    """Draw projections of a refused scan with all candidates, and the brightness along the needle."""
    figure = make_figure_mm(180.0, 175.0)
    if found is None:
        return figure
    width = (180.0 - 2 * _VIEW_LEFT_MM - _VIEW_GAP_MM) / 2
    extent = np.array(found.grid.size) * found.grid.spacing
    scale = min(width / extent[0], width / extent[1], _MAX_VIEW_MM / extent[2])
    for n, view in enumerate((1, 2)):
        right, up = _VIEWS[view]
        box = (_VIEW_LEFT_MM + n * (width + _VIEW_LEFT_MM + _VIEW_GAP_MM), 172.0 - scale * extent[up])
        _paint_view(add_panel_mm(figure, (*box, scale * extent[right], scale * extent[up])), found, view)
    if found.profile is not None:
        _paint_profile(figure, found)
    return figure


def paint_across(found: Findings | None) -> Figure:
    """Draw the projection of a refused scan along the slices' normal, with all candidates."""
    if found is None:
        return make_figure_mm(_ACROSS_MM, 20.0)
    extent = np.array(found.grid.size) * found.grid.spacing
    scale = min((_ACROSS_MM - _VIEW_LEFT_MM) / extent[0], 70.0 / extent[1])
    figure = make_figure_mm(_ACROSS_MM, scale * extent[1] + _VIEW_BOTTOM_MM + 2)
    _paint_view(
        add_panel_mm(figure, (_VIEW_LEFT_MM, _VIEW_BOTTOM_MM, scale * extent[0], scale * extent[1])), found, 0
    )
    return figure


def _paint_view(axes: Axes, found: Findings, view: int) -> None:
    """Draw a projection in mm from the first voxel, with all candidates."""
    right, up = _VIEWS[view]
    extent = np.array(found.grid.size) * found.grid.spacing
    axes.imshow(
        found.projections[view], cmap="gray", vmin=_WINDOW_HU[0], vmax=_WINDOW_HU[1], origin="lower",
        extent=(0.0, extent[right], 0.0, extent[up]), aspect="equal", interpolation="nearest",
    )  # fmt: skip
    for n, tube in enumerate(found.tubes, start=1):
        ends = _to_voxel_mm(found.grid, tube.ends)[:, [right, up]]
        axes.plot(*ends.T, color=NEEDLE_COLOUR, lw=1.4 if tube.chosen else 0.7)
        axes.annotate(str(n), ends[0], color=NEEDLE_COLOUR, fontsize=7, fontweight="bold")
    for n, ball in enumerate(found.balls, start=1):
        at = tuple(_to_voxel_mm(found.grid, ball.center)[0, [right, up]].tolist())
        fill = MARKER_COLOUR if ball.marker else "none"
        axes.plot(*at, "o", mec=MARKER_COLOUR, mfc=fill, ms=4, mew=0.9)
        axes.annotate(str(n), at, (3, 2), textcoords="offset points", color=MARKER_COLOUR, fontsize=7)
    if found.needle is not None:
        tip = _to_voxel_mm(found.grid, found.needle[-1:])[0, [right, up]]
        axes.plot(*tip, "o", color=TIP_COLOUR, ms=3, mew=0)
    entries = _to_voxel_mm(found.grid, found.entry_points)[:, [right, up]]
    for n, at in enumerate(entries, start=1):
        axes.plot(*at, "D", mec=ENTRY_COLOUR, mfc="none", ms=4, mew=0.9)
        axes.annotate(str(n), at, (3, -7), textcoords="offset points", color=ENTRY_COLOUR, fontsize=7)
    axes.set(xlim=(0, extent[right]), ylim=(0, extent[up]))
    axes.set(xlabel=f"along {_AXES[right]} (mm)", ylabel=f"along {_AXES[up]} (mm)")


def _to_voxel_mm(grid: VoxelGrid, points: Floats) -> Floats:
    """Return points (N, 3), LPS, along the voxels' axes, mm from the first voxel's outer corner."""
    return np.asarray((to_index(grid, np.atleast_2d(points)) + 0.5) * grid.spacing)


def _paint_profile(figure: Figure, found: Findings) -> None:
    profile, needle = found.profile, found.needle
    assert profile is not None and needle is not None
    tip = float(arc_length(needle)[-1])
    for n, (values, name) in enumerate(((profile.around, "surroundings"), (profile.core, "needle"))):
        bottom = _VIEW_BOTTOM_MM + n * (_PROFILE_MM + 3.0)
        axes = add_panel_mm(figure, (_VIEW_LEFT_MM, bottom, 180.0 - _VIEW_LEFT_MM - 1.0, _PROFILE_MM))
        axes.plot(profile.s - tip, values, color=INK, lw=0.9)
        axes.axvline(0.0, color=TIP_COLOUR, lw=0.7)
        for number, one in enumerate(found.entries, start=1):
            axes.axvline(-one.depth, color=ENTRY_COLOUR, lw=0.8)
            if n:
                at = (-one.depth, 1.0)
                axes.annotate(
                    str(number), at, (0, 1), xycoords=("data", "axes fraction"), ha="center",
                    textcoords="offset points", fontsize=7, color=ENTRY_COLOUR,
                )  # fmt: skip
        axes.set_ylabel(f"{name}\n(HU)")
        axes.yaxis.set_label_coords(-9.0 / (180.0 - _VIEW_LEFT_MM), 0.5)
        axes.yaxis.set_major_locator(MaxNLocator(3))
        draw_grid(axes, "y")
        if n:
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel("along the needle from its tip (mm)")
            axes.axhline(0.0, color=GREY, lw=0.4)
