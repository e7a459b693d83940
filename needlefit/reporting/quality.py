"""One page per scan on which a person sees in a minute whether its reconstruction can be trusted."""

import tempfile
from pathlib import Path

import numpy as np

from needlefit.imaging.reconstruction import Reconstruction
from needlefit.project.atomic_write import replace_file
from needlefit.reporting import document
from needlefit.reporting.figures.across import across
from needlefit.reporting.figures.along import along
from needlefit.reporting.names import medium_name
from needlefit.reporting.numbers import fixed

Fact = tuple[str, str]

MAX_LISTED_WARNINGS = 10
"""Warnings on a page; the table of the batch has all."""

_ALONG = (
    "Above, the scan in slabs that follow the needle (crosses: centres of markers nearby); below, "
    "brightness, deflection, cross-sections off the axis. Lines: entry, layers, tip. Bands: 95 %, "
    "of the axis, not of single sections."
)
_ACROSS = "The scan across the needle near its tip, and the markers' distances from their known places."
_POSES = {"stage": "the stage", "shaft": "the straight shaft outside"}
_PLANES = {"stated": "the stated bevel", "bevel": "the bevel in the scan", "shape": "the needle's shape"}
_MARKERS = {"volume": "found in the scan", "fiducials": "placed by hand"}


def write_quality(reconstruction: Reconstruction, path: Path) -> Path:
    """Write the page (A4, PDF) whole or not at all; the same reconstruction gives the same bytes.

    Raises
    ------
    ConfigError
        If nothing can be written there.
    """
    with tempfile.TemporaryDirectory(prefix="needlefit-") as name:
        pictures = [
            along(reconstruction, Path(name, "along.pdf")),
            across(reconstruction, Path(name, "across.pdf")),
        ]
        page = document.set_page("quality.typ", _payload(reconstruction), document.by_name(pictures))
    with replace_file(path) as new:
        new.write_bytes(page)
    return path


def facts(reconstruction: Reconstruction) -> list[list[Fact]]:
    """Return what the page says in words and numbers, in groups that belong together."""
    groups = [_scan(reconstruction), _registered(reconstruction), _placed(reconstruction)]
    return [group for group in [*groups, _needle(reconstruction), _layers(reconstruction)] if group]


def _payload(reconstruction: Reconstruction) -> document.Block:
    scan = reconstruction.scan
    said = [medium_name(scan.medium), scan.specimen, scan.volume.name]
    return {
        "title": f"Reconstruction of {scan.id}",
        "subtitle": " · ".join(word for word in said if word),
        "synthetic": scan.origin == "synthetic",
        "mark": "SYNTHETIC DATA",
        "version": document.version_text(),
        "groups": facts(reconstruction),
        "warnings": _list_warnings(reconstruction.warnings),
        "caption": _ALONG,
        "along": _ALONG,
        "across": _ACROSS,
    }


def _list_warnings(warnings: tuple[str, ...]) -> list[str]:
    """Return as many warnings as a page holds, and how many more there are."""
    left = len(warnings) - MAX_LISTED_WARNINGS
    shown = [warning.replace("+-", "±") for warning in warnings[:MAX_LISTED_WARNINGS]]
    return [*shown, f"and {left} more, in reconstruction.csv"] if left > 0 else shown


def _scan(reconstruction: Reconstruction) -> list[Fact]:
    spacing = reconstruction.spacing
    same = np.ptp(spacing) < 5e-4
    edges = f"{spacing[0]:.3g}" if same else " × ".join(f"{edge:.3g}" for edge in spacing)
    return [("voxels", f"{edges} mm" + (", cubes" if same else ""))]


def _registered(reconstruction: Reconstruction) -> list[Fact]:
    markers, registration = reconstruction.markers, reconstruction.registration
    if markers is None or registration is None:
        return [("world", "the patient frame (LPS) of the scan; no markers")]
    paired, found = len(registration.pairs), len(markers.centers)
    more = f"; {found - paired} more belong to none" if found > paired else ""
    entry, tip = reconstruction.target_error
    return [
        ("markers", f"{paired} of {registration.known} {_MARKERS[markers.source]}{more}"),
        ("registration", f"FRE {fixed(registration.fre)} mm; {fixed(registration.expected_fre)} expected"),
        ("error it leaves", f"{fixed(entry)} mm at the entry, {fixed(tip)} at the tip, predicted"),
    ]


def _placed(reconstruction: Reconstruction) -> list[Fact]:
    pose, off = reconstruction.pose, reconstruction.local[:, 2]
    return [
        ("entry pose", f"from {_POSES[pose.source]}"),
        (
            "",
            f"± {fixed(pose.along_sd)} mm along, ± {fixed(pose.shift_sd)} mm and "
            f"± {fixed(np.degrees(pose.angle_sd))}° across",
        ),
        ("bending plane", f"from {_PLANES[reconstruction.plane]}"),
        ("out of plane", f"{fixed(_rms(off))} mm (rms), {fixed(float(np.abs(off).max()))} mm at most"),
    ]


def _needle(reconstruction: Reconstruction) -> list[Fact]:
    along_sd, across_sd = reconstruction.needle_axis.tip_sd
    return [
        ("inserted length", _with_sd(reconstruction.depth, reconstruction.depth_sd)),
        ("tip's deflection", f"{fixed(float(reconstruction.local[-1, 1]))} mm"),
        ("tip", f"± {fixed(along_sd)} mm along, ± {fixed(across_sd)} mm across"),
        ("centreline", f"± {_rms(reconstruction.sd):.3f} mm across (rms)"),
    ]


def _layers(reconstruction: Reconstruction) -> list[Fact]:
    layers = reconstruction.layers
    return [
        (
            "layers" if n == 0 else "",
            f"{layers.sequence[n]} → {layers.sequence[n + 1]} at {_with_sd(float(depth), float(sd))}",
        )
        for n, (depth, sd) in enumerate(zip(layers.boundaries, layers.sd, strict=True))
    ] or [("layers", "no boundary crossed")]


def _with_sd(value: float, sd: float) -> str:
    return f"{fixed(value)} ± {fixed(sd)} mm"


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
