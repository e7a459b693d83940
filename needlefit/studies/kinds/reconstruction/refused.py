"""What a refused scan leaves: a page with everything that was found in it, and its candidates as tables."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from needlefit.arrays import Floats
from needlefit.errors import NeedlefitError
from needlefit.imaging.batch import ReconstructionFailure
from needlefit.imaging.findings import Findings
from needlefit.imaging.scans import write_scan_table
from needlefit.project.atomic_write import replace_folder
from needlefit.project.toml_text import dumps
from needlefit.reporting import document
from needlefit.reporting.figures.style import draw
from needlefit.reporting.labels import medium_name
from needlefit.reporting.table_files import write_csv
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.studies.kinds.reconstruction.quality import Fact, write_scan_page
from needlefit.studies.kinds.reconstruction.refused_figures import paint_across, paint_along

SCANS_FILE, RECIPE_FILE = "scans.csv", "recipe.toml"

REFUSED_COLUMNS = ("id", "scan", "note")
CANDIDATE_COLUMNS = (
    *("id", "kind", "number", "x_mm", "y_mm", "z_mm", "width_mm", "depth_mm", "depth_sd_mm", "note"),
)

_ALONG_CAPTION = (
    "Largest brightness through the scan, along j and along i; lines: tubes (bold: taken as the needle); "
    "circles: balls (filled: markers). Below, brightness along the needle; lines: where soft material begins."
)
_ACROSS_CAPTION = "Largest brightness through the scan, along k."


def write_refused(
    failures: Sequence[ReconstructionFailure], recipe: ReconstructionRecord, folder: Path
) -> None:
    """Write a folder of refused scans alone: `quality/<id>.pdf`, `refused.csv` and `candidates.csv`.

    Their table and their recipe are written beside these, from which the scans are opened again.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as fresh:
        write_refused_pages(failures, fresh / "quality")
        for name, frame in tabulate_failures(failures).items():
            write_csv(frame, fresh / f"{name}.csv")
        write_scan_table([one.scan for one in failures], fresh / SCANS_FILE, folder)
        (fresh / RECIPE_FILE).write_text(
            dumps(recipe.model_dump(mode="json", by_alias=True)), encoding="utf-8"
        )


def write_refused_pages(failures: Sequence[ReconstructionFailure], folder: Path) -> None:
    """Write `<id>.pdf` of each refused scan into a folder."""
    folder.mkdir(exist_ok=True)
    for failure in failures:
        write_refused_page(failure, folder / f"{failure.scan.id}.pdf")


def tabulate_failures(failures: Sequence[ReconstructionFailure]) -> dict[str, pd.DataFrame]:
    """Return the tables of refused scans, by name."""
    return {"refused": tabulate_refused(failures), "candidates": tabulate_candidates(failures)}


def tabulate_refused(failures: Sequence[ReconstructionFailure]) -> pd.DataFrame:
    """Return a row for each refused scan: why, and what would fix it."""
    rows = [(one.scan.id, one.scan.volume.name, ". ".join(_list_reasons(one.error))) for one in failures]
    return pd.DataFrame(rows, columns=list(REFUSED_COLUMNS))


def _list_reasons(error: NeedlefitError) -> list[str]:
    """Return the parts of an error, each in words."""
    named = {"where": error.where, "expected": error.expected, "fix": error.fix}
    return [f"refused: {error.what}", *(f"{name}: {text}" for name, text in named.items() if text)]


def tabulate_candidates(failures: Sequence[ReconstructionFailure]) -> pd.DataFrame:
    """Return what was found: tubes (a row for each end), balls and places of entry; LPS, mm."""
    rows = [row for one in failures if one.findings for row in _list_rows(one.scan.id, one.findings)]
    return pd.DataFrame(rows, columns=list(CANDIDATE_COLUMNS))


def _list_rows(id_: str, found: Findings) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []

    def add(kind: str, number: int, at: Floats, **more: object) -> None:
        place = dict(zip(("x_mm", "y_mm", "z_mm"), at.tolist(), strict=True))
        rows.append({"id": id_, "kind": kind, "number": number, **place, **more})

    for n, tube in enumerate(found.tubes, start=1):
        note = f"{tube.length:.1f} mm long" + (", taken as the needle" if tube.chosen else "")
        for end in tube.ends:
            add("tube", n, end, width_mm=tube.width, note=note)
    for n, ball in enumerate(found.balls, start=1):
        add("ball", n, ball.center, width_mm=ball.diameter, note="marker" if ball.marker else "")
    for n, (one, at) in enumerate(zip(found.entries, found.entry_points, strict=True), start=1):
        note = "air before it" if one.change == "rise" else "another soft material before it"
        add("entry", n, at, depth_mm=one.depth, depth_sd_mm=one.sd, note=note)
    return rows


def write_refused_page(failure: ReconstructionFailure, path: Path) -> Path:
    """Write the page of a refused scan (A4, PDF), completely or not at all.

    Raises
    ------
    ConfigError
        If nothing can be written there.
    """
    found = failure.findings
    return write_scan_page(
        path,
        _payload(failure),
        lambda picture: draw(picture, lambda: paint_along(found)),
        lambda picture: draw(picture, lambda: paint_across(found)),
    )


def _payload(failure: ReconstructionFailure) -> document.Block:
    scan, found = failure.scan, failure.findings
    summary = [medium_name(scan.medium), scan.specimen, scan.volume.name]
    return {
        "title": f"Refused: {scan.id}",
        "subtitle": " · ".join(word for word in summary if word),
        "synthetic": scan.origin == "synthetic",
        "mark": "SYNTHETIC DATA",
        "version": document.find_version(),
        "groups": [[("scan", "could not be read")]] if found is None else list_finding_facts(found),
        "warnings": [text.replace("+-", "±") for text in _list_reasons(failure.error)],
        "caption": _ALONG_CAPTION,
        "along": _ALONG_CAPTION,
        "across": _ACROSS_CAPTION,
    }


def list_finding_facts(found: Findings) -> list[list[Fact]]:
    """Return the facts of the page of a refused scan, in groups."""
    spacing = " × ".join(f"{edge:.3g}" for edge in found.grid.spacing)
    size = " × ".join(str(count) for count in found.grid.size)
    tubes = [
        (
            f"tube {n}" + (" (needle)" if tube.chosen else ""),
            f"{tube.length:.1f} mm long, {tube.width:.1f} wide; L, P, S {_format_place(tube.ends[0])} to "
            f"{_format_place(tube.ends[1])}",
        )
        for n, tube in enumerate(found.tubes, start=1)
    ]
    balls = [
        (
            f"ball {n}" + (" (marker)" if ball.marker else ""),
            f"{ball.diameter:.1f} mm; L, P, S {_format_place(ball.center)}",
        )
        for n, ball in enumerate(found.balls, start=1)
    ]
    entries = [
        (
            f"entry {n}",
            f"{one.depth:.2f} ± {one.sd:.2f} mm before the tip, {one.run.level:.0f} HU ({one.change})",
        )
        for n, one in enumerate(found.entries, start=1)
    ]
    return [
        [("voxels", f"{size}, {spacing} mm")],
        tubes or [("tubes", "none")],
        balls or [("balls", "none found, or none needed")],
        entries or [("entry", "not looked for: no needle" if found.needle is None else "none")],
    ]


def _format_place(at: Floats) -> str:
    return ", ".join(f"{x:.0f}" for x in at)
