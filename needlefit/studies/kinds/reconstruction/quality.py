"""The quality page of a reconstructed scan: one page for a quick visual check."""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from needlefit.imaging.reconstruction import Reconstruction
from needlefit.project.atomic_write import replace_file
from needlefit.reporting import document
from needlefit.reporting.labels import medium_name
from needlefit.reporting.number_format import format_mm
from needlefit.studies.kinds.reconstruction.figures import draw_needle_section, draw_tip_section

Fact = tuple[str, str]

MAX_LISTED_WARNINGS = 10
"""Number of warnings on a page; the table of the batch has all of them."""

_ALONG_CAPTION = (
    "Above, the scan in slabs that follow the needle (crosses: centres of markers nearby); below, "
    "brightness, deflection, cross-sections off the axis. Lines: entry, layers, tip. Bands: 95 %, "
    "of the axis, not of single sections."
)
_ACROSS_CAPTION = (
    "The scan across the needle near its tip, and the markers' distances from their known places."
)
_POSE_SOURCES = {"stage": "the stage", "shaft": "the straight shaft outside"}
_PLANE_SOURCES = {
    "stated": "the stated bevel",
    "bevel": "the bevel in the scan",
    "shape": "the needle's shape",
}
_MARKER_SOURCES = {"volume": "found in the scan", "fiducials": "placed by hand"}


DrawPicture = Callable[[Path], Path]
"""Draws a picture into a file, which it returns."""


def write_quality(reconstruction: Reconstruction, path: Path) -> Path:
    """Write the quality page (A4, PDF), completely or not at all; equal reconstructions give equal bytes.

    Raises
    ------
    ConfigError
        If nothing can be written there.
    """
    along, across = (partial(draw, reconstruction) for draw in (draw_needle_section, draw_tip_section))
    return write_scan_page(path, _payload(reconstruction), along, across)


def write_scan_page(path: Path, payload: document.Block, along: DrawPicture, across: DrawPicture) -> Path:
    """Write a page with two pictures of a scan (A4, PDF), completely or not at all.

    Raises
    ------
    ConfigError
        If nothing can be written there.
    """
    with tempfile.TemporaryDirectory(prefix="needlefit-") as name:
        pictures = [along(Path(name, "along.pdf")), across(Path(name, "across.pdf"))]
        page = document.compile_template("quality.typ", payload, document.key_by_file_name(pictures))
    with replace_file(path) as new:
        new.write_bytes(page)
    return path


def list_facts(reconstruction: Reconstruction) -> list[list[Fact]]:
    """Return the facts and numbers of the page, in groups."""
    groups = [
        _scan_facts(reconstruction),
        _registration_facts(reconstruction),
        _placement_facts(reconstruction),
    ]
    return [
        group
        for group in [
            *groups,
            _needle_facts(reconstruction),
            _layer_facts(reconstruction),
            _proposal_facts(reconstruction),
        ]
        if group
    ]


def _payload(reconstruction: Reconstruction) -> document.Block:
    scan = reconstruction.scan
    summary = [medium_name(scan.medium), scan.specimen, scan.volume.name]
    return {
        "title": f"Reconstruction of {scan.id}",
        "subtitle": " · ".join(word for word in summary if word),
        "synthetic": scan.origin == "synthetic",
        "mark": "SYNTHETIC DATA",
        "version": document.find_version(),
        "groups": list_facts(reconstruction),
        "warnings": _list_warnings(reconstruction.warnings),
        "caption": _ALONG_CAPTION,
        "along": _ALONG_CAPTION,
        "across": _ACROSS_CAPTION,
    }


def _list_warnings(warnings: tuple[str, ...]) -> list[str]:
    """Return as many warnings as a page holds, and how many more there are."""
    left = len(warnings) - MAX_LISTED_WARNINGS
    shown = [warning.replace("+-", "±") for warning in warnings[:MAX_LISTED_WARNINGS]]
    return [*shown, f"and {left} more, in reconstruction.csv"] if left > 0 else shown


def _scan_facts(reconstruction: Reconstruction) -> list[Fact]:
    spacing = reconstruction.spacing
    same = np.ptp(spacing) < 5e-4
    edges = f"{spacing[0]:.3g}" if same else " × ".join(f"{edge:.3g}" for edge in spacing)
    return [("voxels", f"{edges} mm" + (", cubes" if same else ""))]


def _registration_facts(reconstruction: Reconstruction) -> list[Fact]:
    markers, registration = reconstruction.markers, reconstruction.registration
    if markers is None or registration is None:
        return [("world", "the patient frame (LPS) of the scan; no markers")]
    paired, found = len(registration.pairs), len(markers.centers)
    more = f"; {found - paired} more belong to none" if found > paired else ""
    entry, tip = reconstruction.target_error
    return [
        ("markers", f"{paired} of {registration.known} {_MARKER_SOURCES[markers.source]}{more}"),
        (
            "registration",
            f"FRE {format_mm(registration.fre)} mm; {format_mm(registration.expected_fre)} expected",
        ),
        ("error it leaves", f"{format_mm(entry)} mm at the entry, {format_mm(tip)} at the tip, predicted"),
    ]


def _placement_facts(reconstruction: Reconstruction) -> list[Fact]:
    pose, off = reconstruction.pose, reconstruction.local[:, 2]
    return [
        ("entry pose", f"from {_POSE_SOURCES[pose.source]}"),
        (
            "",
            f"± {format_mm(pose.along_sd)} mm along, ± {format_mm(pose.shift_sd)} mm and "
            f"± {format_mm(np.degrees(pose.angle_sd))}° across",
        ),
        ("bending plane", f"from {_PLANE_SOURCES[reconstruction.plane]}"),
        (
            "out of plane",
            f"{format_mm(_rms(off))} mm (rms), {format_mm(float(np.abs(off).max()))} mm at most",
        ),
    ]


def _needle_facts(reconstruction: Reconstruction) -> list[Fact]:
    along_sd, across_sd = reconstruction.needle_axis.tip_sd
    return [
        ("inserted length", _format_with_sd(reconstruction.depth, reconstruction.depth_sd)),
        ("tip's deflection", f"{format_mm(float(reconstruction.local[-1, 1]))} mm"),
        ("tip", f"± {format_mm(along_sd)} mm along, ± {format_mm(across_sd)} mm across"),
        ("centreline", f"± {_rms(reconstruction.sd):.3f} mm across (rms)"),
    ]


def _layer_facts(reconstruction: Reconstruction) -> list[Fact]:
    layers = reconstruction.layers
    return [
        (
            "layers" if n == 0 else "",
            f"{layers.sequence[n]} → {layers.sequence[n + 1]} at {_format_with_sd(float(depth), float(sd))}",
        )
        for n, (depth, sd) in enumerate(zip(layers.boundaries, layers.sd, strict=True))
    ] or [("layers", "no boundary crossed")]


def _proposal_facts(reconstruction: Reconstruction) -> list[Fact]:
    """Return the interfaces that the scan shows, by their place along the needle."""
    found = reconstruction.proposals
    if found is None:
        return []
    return [
        (
            f"proposed {n}",
            f"{n} → {n + 1} at {_format_with_sd(one.at, one.sd)} along the needle, {one.step:+.0f} HU",
        )
        for n, one in enumerate(found, start=1)
    ] or [("proposed", "no interface shows")]


def _format_with_sd(value: float, sd: float) -> str:
    return f"{format_mm(value)} ± {format_mm(sd)} mm"


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
