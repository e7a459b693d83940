"""Show what an import understood: a table of its needles, and a picture of them in both frames."""

from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from needlefit.arrays import Floats
from needlefit.datasets.bend_sides import Bend, BendSide, measure_bends
from needlefit.datasets.first_study import write_first_runs
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.datasets.importing.meanings import COORDINATES, MEANINGS, VALUES
from needlefit.datasets.importing.place import ImportPlan
from needlefit.datasets.importing.prepare import PreparedImport
from needlefit.datasets.importing.writing import CURVATURE_FILE, TRACKS_FILE, TURNS_FILE, write_plan
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.record_warnings import MAPPING_FILE
from needlefit.geometry.surfaces import Surface
from needlefit.grouping import group_values
from needlefit.project.folders import replace_folder
from needlefit.project.locate import join_names
from needlefit.reporting.figures.style import draw, draw_grid, label_origin, separate_positions
from needlefit.reporting.labels import GREY, INK
from needlefit.schemas.origin import ORIGIN_MARKS

PICTURE_FILE = "import.png"
WRITTEN = (  # names of the files of an import
    *("dataset.toml", MAPPING_FILE, PICTURE_FILE),
    *("tissue*.toml", "*_study.toml", "*_fit.toml", "scene*.toml"),
    *("insertions.csv", TRACKS_FILE, TURNS_FILE, CURVATURE_FILE, "centerlines/*.csv", "layers/*.stl"),
)

# largest number of needles of a drawing that are named: more names would cover each other
MAX_LABELLED_NEEDLES = 14
MAX_NAME_CHARS = 14  # largest number of characters of a name beside a needle
AWAY_COLOUR = "#b3261e"
MAX_DRAWN_TRIANGLES = 20_000  # largest number of triangles of a surface that are drawn
MAX_SHOWN_CELLS = 4  # number of cells of a row in a table
MAX_FIRST_VALUES = 3  # number of values of a column in a table
MAX_LISTED_UNUSED = 6  # largest number of columns, or of rows, of one file that a line lists

_SURFACE_COLOURS = ("#c8b88a", "#a9b7c6", "#c9a3a3", "#a8bfa3")


def write_import(folder: Path, prepared: PreparedImport, overwrite: bool = False) -> Dataset:
    """Write a dataset with its mapping, picture, scene and first study into a new folder, or nothing.

    Tip tracks get no picture. ConfigError if `folder` holds something, with `overwrite` if that is no import.
    DataError listing the faults of the dataset, at their places in the imported files.
    """
    with replace_folder(folder, is_result=False, find=find_not_imported if overwrite else None) as fresh:
        plan = prepared.plan
        dataset = write_plan(fresh, prepared.content, plan, prepared.mapping)
        write_first_runs(fresh, dataset, plan.choices)
        if not all(insertion.in_tracker_frame for insertion in dataset.insertions):
            draw(fresh / PICTURE_FILE, lambda: paint_import(dataset, plan))
    warnings = [
        replace(warning, where=warning.where.replace(str(fresh), str(folder))) for warning in dataset.warnings
    ]
    return replace(dataset, warnings=tuple(warnings))


def find_not_imported(folder: Path) -> list[str]:
    """Return what lies in a folder that no import wrote."""
    if not (folder / MAPPING_FILE).is_file() and any(folder.iterdir()):
        return [f"no {MAPPING_FILE} of an import"]
    files = [path.relative_to(folder).as_posix() for path in sorted(folder.rglob("*")) if not path.is_dir()]
    return [name for name in files if not any(fnmatchcase(name, pattern) for pattern in WRITTEN)]


def tabulate_needles(dataset: Dataset) -> pd.DataFrame:
    """Return one row for each insertion: points or sensors, depth, deflection, entry, layers, bevel."""
    bends = measure_bends(dataset.insertions, dataset.noise)
    return pd.DataFrame([*map(_describe_needle, dataset.insertions, bends)])


def explain_unclear(dataset: Dataset) -> str:
    """Return what bends that are not clear were compared with, and how to state a side; "" without any."""
    bends = measure_bends(dataset.insertions, dataset.noise)
    unclear = (bend.limit_mm for bend in bends if bend.side is BendSide.UNCLEAR and bend.limit_mm > 0)
    limits = [f"{limit_mm:.2g}" for limit_mm in unclear]
    if not limits:
        return ""
    ends = " to ".join(dict.fromkeys([min(limits, key=float), max(limits, key=float)]))
    return (
        f"Not clear: bends that errors explain, of at most {ends} mm. "
        "Such sides are not checked; --set bevel_side=-1 states the other."
    )


def _describe_needle(insertion: Insertion, bend: Bend) -> dict[str, object]:
    entry, tip = insertion.centerline[0], insertion.centerline[-1]
    depths = ", ".join(f"{depth:.1f}" for depth in insertion.boundaries)
    sensors = 0 if insertion.curvature is None else len(insertion.curvature)
    counts = {"tip": 1 + sensors, "curvature": sensors}
    row: dict[str, object] = {
        "insertion": insertion.id,
        "points": counts.get(insertion.observation, len(insertion.centerline)),
        "depth (mm)": round(insertion.depth, 2),
        # the first direction of a free shape is hardly known
        "deflection (mm)": round(bend.toward_mm if bend.is_from_fitted else insertion.deflection, 2),
        "entry x, y, z (mm)": _format_point(entry),
        "tip x, y, z (mm)": _format_point(tip),
        "layers": " > ".join(map(str, insertion.sequence)) + (f" at {depths} mm" if depths else ""),
        "bends, from its bevel": str(bend.side),
    }
    hidden = [*row][4:-1] if insertion.in_tracker_frame else ()  # which no scan has
    return {name: cell for name, cell in row.items() if name not in hidden}


def _format_point(point: Floats) -> str:
    return ", ".join(f"{value:z.1f}" for value in point)


def tabulate_columns(prepared: PreparedImport) -> pd.DataFrame:
    """Return one row for each meaning of each table: its column, unit and first values in mm."""
    rows = list[tuple[str, ...]]()
    for mapped in prepared.content.tables:
        table = f"{mapped.file} {mapped.record.sheet.replace('*', '')}".strip()
        for meaning, column in mapped.record.columns.items():
            unit = column.unit or MEANINGS[meaning].unit
            is_point = meaning in COORDINATES and mapped.has_points
            key = "unit" if is_point else f"{meaning}.unit"
            unit += ", assumed" if unit and key in prepared.mapping.assumed else ""
            header = ", ".join(map(str, column.columns)) or column.source or f"= {column.value}"
            unit = f"column {column.unit_column}" if column.unit_column else unit
            rows.append((table, meaning, header, unit, ", ".join(_list_first(mapped, meaning))))
    keys = ["meaning", "column", "unit"]
    frame = pd.DataFrame(rows, columns=["table", *keys, "first values"])
    if frame["table"].nunique() == 1:
        return frame.drop(columns=["table"])
    more = frame.groupby(keys, sort=False)["table"].transform("size") - 1
    frame["table"] += [f" and {count} more" if count else "" for count in more]
    return frame.drop_duplicates(keys)


def _list_first(mapped: MappedTable, meaning: str) -> list[str]:
    """Return the first values of a meaning, lengths in mm; of texts those that differ."""
    is_length = MEANINGS[meaning].unit == "mm" and meaning not in ("diameter", "entry_point")
    values = list[str]()
    for n, cells in enumerate(mapped.cells[meaning]):
        texts = [*cells[:MAX_SHOWN_CELLS]]
        for k, cell in enumerate(texts) if is_length else ():
            if mapped.number(cell) is not None:
                texts[k] = f"{mapped.read_number(meaning, n, k):.4g} mm"
        value = "; ".join(texts)
        if any(cells) and (is_length or value not in values):
            values.append(value)
        if len(values) == MAX_FIRST_VALUES:
            break
    return values


def tabulate_values(prepared: PreparedImport) -> pd.DataFrame:
    """Return one row for what holds of all needles: key, value, and the reason where it is assumed."""
    mapping, rows = prepared.mapping, list[tuple[str, str, str, str]]()
    for key, reason in mapping.assumed.items():
        value, _, why = reason.partition(": ")
        if key in mapping.values:
            value, why = _show_value(key, mapping.values[key]), reason
        rows.append((key, value, "assumed", why))
    stated = {key: text for key, text in mapping.values.items() if key not in mapping.assumed}
    rows += [(key, _show_value(key, text), "stated", "") for key, text in stated.items()]
    rows += [(key, text, "files", "") for key, text in prepared.notes]
    return pd.DataFrame(rows, columns=["key", "value", "from", "why"])


def _show_value(key: str, text: str) -> str:
    """Return a value with the unit of its key, where it has none of its own."""
    return f"{text} {VALUES[key].unit}".strip() if text[-1:].isdecimal() and key in VALUES else text


def join_unused(unused: Sequence[tuple[str, str]]) -> str:
    """Return what files hold beside what is read, in one sentence; empty if nothing.

    `unused`: what, and where it stands.
    """
    places = group_values(unused)
    lines = [part for part in places if part.startswith("line")]
    shown = [*(part for part in places if part not in lines), *lines[:MAX_LISTED_UNUSED]]
    parts = group_values((tuple(places[part]), part) for part in shown)
    texts = [
        f"{join_names(names, MAX_LISTED_UNUSED)} ({join_names(files, 1)})" for files, names in parts.items()
    ]
    more = len(lines[MAX_LISTED_UNUSED:])
    texts += [f"{more} more line{'s' * (more > 1)}"] if more else []
    return f"Not used: {'; '.join(texts)}." if texts else ""


# ---- the picture


def paint_import(dataset: Dataset, plan: ImportPlan) -> Figure:
    """Draw the needles with the surfaces as they lie in the world, and each one in its own frame."""
    figure = Figure(figsize=(6.7, 2.9))
    label_origin(figure, ORIGIN_MARKS[dataset.origin])
    left, right = figure.subplots(1, 2)
    _draw_world(left, dataset.insertions, plan.surfaces)
    _draw_shapes(right, dataset, "bevel" if plan.rows[0].bevel is not None else "bend")
    figure.draw_without_rendering()  # the layout decides the scales
    for axes, words in ((left, "World: all needles"), (right, "Each from its entry")):
        drawn, (start, end), (low, high) = axes.get_window_extent(), axes.get_xlim(), axes.get_ylim()
        scale = drawn.height / (high - low) / (drawn.width / (end - start))
        axes.set_title(f"{words}\n(vertical scale × {scale:.2g})")
    return figure


def _draw_world(axes: Axes, insertions: Sequence[Insertion], surfaces: Sequence[Surface]) -> None:
    """Draw curves and surfaces along the two axes of the world over which the needles extend most."""
    curves = [insertion.centerline for insertion in insertions]
    points = np.concatenate(curves)
    across, along = np.argsort(np.ptp(points, axis=0), kind="stable")[1:]
    for n, surface in enumerate(surfaces):
        vertices = surface.vertices
        faces = surface.faces[:MAX_DRAWN_TRIANGLES]
        colour = _SURFACE_COLOURS[n % len(_SURFACE_COLOURS)]
        view = Triangulation(vertices[:, along], vertices[:, across], faces)
        axes.triplot(view, color=colour, lw=0.7, alpha=0.9, zorder=1)
        axes.plot([], [], color=colour, lw=2, label=surface.name[:24])
    for curve in curves:
        axes.plot(curve[:, along], curve[:, across], color=INK, lw=0.9, zorder=3)
    for label, end, marker, fill in (("entry", 0, "o", "white"), ("tip", -1, "v", INK)):
        ends = np.array([curve[end] for curve in curves])
        axes.plot(ends[:, along], ends[:, across], marker, ms=3.5, mfc=fill, mec=INK, label=label, zorder=4)
    for set_limits, axis in ((axes.set_xlim, along), (axes.set_ylim, across)):
        low, high = float(points[:, axis].min()), float(points[:, axis].max())
        margin = 0.1 * max(high - low, 10.0)
        set_limits(low - margin, high + margin)
    # the two lines of the title, with the scale, follow the layout
    axes.set(title="\n", xlabel=f"{'xyz'[along]} (mm)", ylabel=f"{'xyz'[across]} (mm)")
    axes.legend(fontsize=6, loc="best")


def _draw_shapes(axes: Axes, dataset: Dataset, side: str) -> None:
    """Draw every needle in its own frame, deflection exaggerated, with the layers' boundaries."""
    ones = dataset.insertions
    axes.axhline(0.0, color=GREY, lw=0.6)
    for insertion, bend in zip(ones, measure_bends(ones, dataset.noise), strict=True):
        x, y, _ = insertion.points.T
        axes.plot(x, y, color=AWAY_COLOUR if bend.is_away else INK, lw=0.9)
        axes.plot(insertion.boundaries, np.interp(insertion.boundaries, x, y), "|", color=INK, ms=6)
    if len(ones) <= MAX_LABELLED_NEEDLES:
        _label_tips(axes, ones)
    toward = f", toward the {side}" if all(insertion.side > 0 for insertion in ones) else ""
    axes.set(
        title="\n",
        xlabel="x, along the entry direction (mm)",
        ylabel=f"y{toward} (mm)",
    )
    draw_grid(axes)


def _label_tips(axes: Axes, ones: Sequence[Insertion]) -> None:
    """Write the names at the right, in the order of the tips, each with a line to its tip."""
    tips = sorted(((*insertion.points[-1, :2], insertion.id) for insertion in ones), key=lambda tip: tip[1])
    low, high = axes.get_ylim()
    right = 1.08 * max(tip[0] for tip in tips)
    offsets = 0.055 * (high - low) * np.arange(len(tips), dtype=np.float64)
    places = separate_positions([tip[1] for tip in tips], offsets)
    for (x, y, name), place in zip(tips, places, strict=True):
        axes.plot([x, right], [y, place], color=GREY, lw=0.4)
        axes.text(right, place, f" {name[:MAX_NAME_CHARS]}", fontsize=6, va="center")
    axes.set_xlim(None, 1.35 * right)
