"""Pages of a scan, for a quick visual check: of a reconstructed one, and of one that was refused."""

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.imaging.batch import Findings, ReconstructionFailure
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.scans import Scan
from needlefit.project.folders import replace_file
from needlefit.reporting import document
from needlefit.reporting.figures.style import draw
from needlefit.reporting.labels import medium_name
from needlefit.reporting.number_format import format_mm
from needlefit.studies.kinds.reconstruction import figures
from needlefit.studies.kinds.reconstruction.run import list_reasons

Fact = tuple[str, str]
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
    left = len(one.warnings) - MAX_LISTED_WARNINGS
    warnings = [
        *one.warnings[:MAX_LISTED_WARNINGS],
        *[f"and {left} more, in reconstruction.csv"] * (left > 0),
    ]
    words = (f"Reconstruction of {one.scan.id}", list_facts(one), warnings, _QUALITY_CAPTIONS)
    pictures = (partial(figures.paint_needle_section, one), partial(figures.paint_tip_section, one))
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
        pictures = (partial(figures.paint_along, found), partial(figures.paint_across, found))
        _write_page(folder / f"{scan.id}.pdf", scan, words, pictures)


def _write_page(
    path: Path,
    scan: Scan,
    words: tuple[str, list[list[Fact]], list[str], tuple[str, str]],
    pictures: Sequence[figures.Paint],
) -> Path:
    """Write a page with two pictures of a scan (A4, PDF), completely or not at all.

    `words`: title, facts in groups, warnings, and the captions of the pictures.
    """
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
        page = document.compile_template("quality.typ", payload, document.key_by_file_name(drawn))
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
    depths = zip(one.layers.boundaries, one.layers.sd, strict=True)
    most = format_mm(float(np.abs(off).max()))
    layers = [
        (
            "layers" if n == 0 else "",
            f"{one.layers.sequence[n]} → {one.layers.sequence[n + 1]} at {_with_sd(float(depth), float(sd))}",
        )
        for n, (depth, sd) in enumerate(depths)
    ]
    proposed = [
        (
            f"proposed {n}",
            f"{n} → {n + 1} at {_with_sd(found.at, found.sd)} along the needle, {found.step:+.0f} HU",
        )
        for n, found in enumerate(one.proposals or (), start=1)
    ]
    groups = [
        [("voxels", f"{edges} mm" + (", cubes" if same else ""))],
        _list_registration_facts(one),
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
    if one.proposals is not None:
        groups.append(proposed or [("proposed", "no interface shows")])
    return groups


def _list_registration_facts(one: Reconstruction) -> list[Fact]:
    markers, fit = one.markers, one.registration
    if markers is None or fit is None:
        return [("world", "the patient frame (LPS) of the scan; no markers")]
    paired, found = len(fit.pairs), len(markers.centers)
    more = f"; {found - paired} more belong to none" if found > paired else ""
    entry, tip = one.target_error
    return [
        ("markers", f"{paired} of {fit.known} {_SOURCES[markers.source]}{more}"),
        ("registration", f"FRE {format_mm(fit.fre)} mm; {format_mm(fit.expected_fre)} expected"),
        ("error it leaves", f"{format_mm(entry)} mm at the entry, {format_mm(tip)} at the tip, predicted"),
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
        level = f"{one.run.level:.0f} HU ({one.change})"
        entries.append((f"entry {n}", f"{one.depth:.2f} ± {one.sd:.2f} mm before the tip, {level}"))
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
