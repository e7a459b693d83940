"""Read which scans to reconstruct, from a table or from volumes named one by one; write such a table."""

import csv
import difflib
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import BEVEL_COLUMNS, make_id
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.formats.csv import CsvTable, list_columns, parse_numbers, read_table
from needlefit.imaging.scan import (
    CONTACT_COLUMNS,
    NEEDLE_COLUMNS,
    NUMBER_COLUMNS,
    PROPOSE_LAYERS,
    SCAN_COLUMNS,
    SCANS_DOCUMENT,
    STAGE_COLUMNS,
    TIP_COLUMNS,
    Scan,
    ScanRow,
    build_scan,
    label_faults,
    name_faults,
    parse_layer_source,
    row_faults,
    unmatched_fiducials_fault,
)
from needlefit.imaging.volume import ARCHIVE_SUFFIX, IMAGE_SUFFIXES, READABLE_VOLUMES
from needlefit.project.input_files import is_file, path_exists

MISSING_VOLUME = Fault("", "there is no such file or folder", READABLE_VOLUMES, "check the path")

SCAN_TABLE_FIX = "write a table of scans, with a column for it"


def read_scans(path: Path) -> tuple[Scan, ...]:
    """Read a table of scans, one per row, in its order; paths in it are relative to its folder.

    Only `scan` is required; what an empty cell means `Scan` says. An id that is not given is the volume's
    name. Surfaces are separated by `;`, each a file or `file=kind:into`, e.g. `skin.stl=sheet:2`.

    Raises
    ------
    DataError
        Listing every fault of the table, with its line: cells, columns that are unknown, files missing.
    """
    table = read_table(path, SCANS_DOCUMENT)
    found = list(_column_faults(table))
    rows = _parse_rows(table, found)
    unread = {fault.where for fault in found}
    for row in rows:
        found += row_faults(row, numbers_read=row.where not in unread)
    found += _mixed_marker_faults(rows)
    ids = [row.text["id"] or scan_id(Path(row.text["scan"])) for row in rows]
    found += _repeated_id_faults(ids, [row.where for row in rows])
    if found:
        raise as_error(found, path)
    return tuple(build_scan(row, id_) for row, id_ in zip(rows, ids, strict=True))


def make_scans(
    volumes: Sequence[Path],
    *,
    medium: str = "medium",
    markers: Path | None = None,
    layers: Sequence[str] = (),
    surfaces_in: Literal["world", "scan"] = "world",
    fiducials: Path | None = None,
    mask: Path | None = None,
    series: str | None = None,
) -> tuple[Scan, ...]:
    """Return a scan for each of some volumes that share markers and layers; file names become ids.

    Parameters
    ----------
    layers : sequence of str
        Files, each as in a table of scans: `file` or `file=kind:into`; "auto" proposes layers.
    fiducials, mask, series : optional
        Of one scan: no two have them in common.

    Raises
    ------
    DataError
        Listing every file that is missing, every layer that is not understood, names that are alike or name
        no file, and fiducials without markers.
    """
    found = [replace(MISSING_VOLUME, where=str(volume)) for volume in volumes if not path_exists(volume)]
    given = {
        "the known places of the markers": markers,
        "the markers as placed in the scan": fiducials,
        "the needle's voxels": mask,
    }
    for expected, path in given.items():
        if path is not None and not is_file(path):
            found.append(Fault(str(path), "there is no such file", expected, "check the path"))
    if fiducials and not markers:
        found.append(
            unmatched_fiducials_fault(str(fiducials), "name the file of their known places, too: --markers")
        )
    once = fiducials or mask or series
    if len(volumes) > 1 and once:
        found.append(Fault(str(once), f"is given for {len(volumes)} scans", "one scan", SCAN_TABLE_FIX))
    sources = [parse_layer_source(text, Path()) for text in layers if text != PROPOSE_LAYERS]
    found += [source for source in sources if isinstance(source, Fault)]
    found += name_faults("medium", medium, "medium")
    for volume in volumes:
        found += label_faults("scan", volume.name, repr(str(volume)))
    ids = [scan_id(volume) for volume in volumes]
    found += _repeated_id_faults(ids, [str(volume) for volume in volumes])
    if found:
        raise as_error(found, Path(found[0].where))
    surfaces = tuple(source for source in sources if not isinstance(source, Fault))
    return tuple(
        Scan(
            id_,
            volume,
            medium,
            series=series,
            mask=mask,
            markers=markers,
            fiducials=fiducials,
            surfaces=surfaces,
            surfaces_in=surfaces_in,
            propose_layers=PROPOSE_LAYERS in layers,
        )
        for id_, volume in zip(ids, volumes, strict=True)
    )


def scan_id(volume: Path) -> str:
    """Return the id of a volume from its file name: without the ending, and with allowed characters only."""
    name = volume.resolve().name if volume.name in ("", "..") else volume.name
    ending = next(
        (end for end in (".seg.nrrd", *IMAGE_SUFFIXES, ".dcm", ARCHIVE_SUFFIX) if name.lower().endswith(end)),
        "",
    )
    return make_id(name[: len(name) - len(ending)], "scan")


def _column_faults(table: CsvTable) -> Iterator[Fault]:
    """Yield columns that nothing is known of: a name mistyped would silently leave its cells out."""
    where = f"{table.path}:1"
    if "scan" not in table.cells:
        expected = (
            f"the path of each volume: {READABLE_VOLUMES}; there are {list_columns(table.cells.columns)}"
        )
        yield Fault(where, "column `scan` is missing", expected, "add the column")
        return
    for name in table.cells:
        if name not in SCAN_COLUMNS:
            near = difflib.get_close_matches(str(name), SCAN_COLUMNS, n=1, cutoff=0.5)
            fix = f"did you mean `{near[0]}`?" if near else "remove the column, or correct its name"
            yield Fault(where, f"column `{name}` is unknown", f"one of {', '.join(SCAN_COLUMNS)}", fix)


def _mixed_marker_faults(rows: Sequence[ScanRow]) -> Iterator[Fault]:
    """Yield the rows without markers of a table that has some: their worlds would be others."""
    if any(row.text["markers"] for row in rows):
        for row in rows:
            if not row.text["markers"]:
                yield Fault(
                    row.where,
                    "`markers` is empty, but other scans have some",
                    "one world for all: markers for every scan, or for none",
                    "add the markers' places, or put this scan into a table of its own",
                )


def _parse_rows(table: CsvTable, found: list[Fault]) -> list[ScanRow]:
    blank = [""] * len(table.lines)
    text = {name: table.cells[name].tolist() if name in table.cells else blank for name in SCAN_COLUMNS}
    number = {
        name: parse_numbers(table, name, found, optional=True)
        if name in table.cells
        else np.full(len(blank), np.nan)
        for name in NUMBER_COLUMNS
    }
    return [
        ScanRow(
            table.where(n),
            table.path.parent,
            {name: cells[n] for name, cells in text.items()},
            {name: float(values[n]) for name, values in number.items()},
        )
        for n in range(len(blank))
    ]


def _repeated_id_faults(ids: Iterable[str], places: Iterable[str]) -> Iterator[Fault]:
    first: dict[str, str] = {}
    for id_, place in zip(ids, places, strict=True):
        if id_ in first:
            yield Fault(
                place,
                f"has the id {id_}, as {first[id_]} has",
                "a different id for every scan: it names files of the dataset",
                "give each an id of its own in a table of scans",
            )
        first.setdefault(id_, place)


def write_scan_table(scans: Sequence[Scan], path: Path, home: Path | None = None) -> None:
    """Write a table of scans, from which `read_scans` reads the same.

    Paths are relative to its folder, or to `home`, where that will stand.
    """
    rows = [_to_row(scan, home or path.parent) for scan in scans]
    columns = [name for name in SCAN_COLUMNS if any(row.get(name) for row in rows)]
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, columns, extrasaction="ignore", lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def _to_row(scan: Scan, folder: Path) -> dict[str, str]:
    row = {"id": scan.id, "scan": _relative(scan.volume, folder), "medium": scan.medium}
    row |= {"specimen": scan.specimen, "series": scan.series or "", "surfaces_in": scan.surfaces_in}
    for name, named in (("mask", scan.mask), ("markers", scan.markers), ("fiducials", scan.fiducials)):
        row[name] = "" if named is None else _relative(named, folder)
    layers = [layer.name_file(_relative(layer.path, folder)) for layer in scan.surfaces]
    row["surfaces"] = ";".join([*layers, *([PROPOSE_LAYERS] if scan.propose_layers else [])])
    stage = scan.stage
    if stage is not None:
        values = [*stage.entry, *stage.direction, stage.shift_sd, np.degrees(stage.angle_sd)]
        row |= _format_numbers(STAGE_COLUMNS, values)
    for names, point in (
        (BEVEL_COLUMNS, scan.bevel),
        (NEEDLE_COLUMNS, scan.needle_at),
        (CONTACT_COLUMNS, scan.contact),
        (TIP_COLUMNS, scan.tip),
    ):
        row |= {} if point is None else _format_numbers(names, point)
    row |= {"bevel_side": str(scan.side), "origin": scan.origin}
    counts = {"layers": scan.layers, "layers_alternative": scan.layers_alternative}
    row |= {name: "" if count is None else str(count) for name, count in counts.items()}
    lengths = {"guide_distance_mm": scan.guide_distance, "expected_depth_mm": scan.expected_depth}
    return row | {name: "" if length is None else f"{length:.10g}" for name, length in lengths.items()}


def _format_numbers(names: Sequence[str], values: Sequence[float] | Floats) -> dict[str, str]:
    return {name: f"{float(value):.10g}" for name, value in zip(names, values, strict=True)}


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
