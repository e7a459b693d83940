"""Write a simulation-based calibration: tables, the figure of ranks, JSON."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.project.atomic_write import replace_folder
from needlefit.project.result_warnings import WARNINGS_KEY, read_warnings, to_rows
from needlefit.reporting import document
from needlefit.reporting.calibration_summary import (
    SCOPE_NOTE,
    describe_figure,
    lay_out_calibration,
    name_quantity,
    summarize_calibration,
)
from needlefit.reporting.document import Document, compile_pdf
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, is_synthetic, label_origin, plot
from needlefit.reporting.labels import GREY, INK, SYNTHETIC_COLOUR
from needlefit.reporting.table_files import write_csv, write_json
from needlefit.reporting.tables import to_records
from needlefit.validation.calibration.rank_statistics import RANK_DRAWS
from needlefit.validation.calibration.run import Calibration, store_calibration

ECDF_COLOUR = "#0072B2"
MAX_PANEL_COLUMNS = 4


def draw_ranks(found: Calibration, path: Path) -> Path:
    """Draw, for each quantity, the ECDF of the ranks minus that of uniform ranks, on the band expected by
    chance.

    A curve that is first above and then below: posteriors too narrow; the other way round: too wide.
    """
    curves = _tabulate_ecdfs(found).assign(origin=found.origin)
    return plot(path, curves, lambda frame: _paint_ranks(frame, found.failing))


def _tabulate_ecdfs(found: Calibration) -> pd.DataFrame:
    """Return the ECDFs with what is drawn of them: the part of ranks below a place, less the place's own."""
    place, count = found.ecdfs["rank"] / (RANK_DRAWS + 1), len(found.replicates)
    parts = {
        f"{name}_less_uniform": found.ecdfs[name] / count - place
        for name in ("below", "count_low", "count_high")
    }
    return found.ecdfs.assign(uniform=place, **parts)


def _paint_ranks(curves: pd.DataFrame, failing: Sequence[str]) -> Figure:
    groups = list(curves.groupby("quantity", sort=False))
    down = math.ceil(len(groups) / MAX_PANEL_COLUMNS)
    figure = Figure(figsize=(TEXT_WIDTH_IN, 0.35 + 1.45 * down))
    panels = figure.subplots(down, MAX_PANEL_COLUMNS, sharex=True, sharey=True, squeeze=False)
    for axes, (name, rows) in zip(panels.flat, groups, strict=False):
        _paint_rank_panel(axes, rows)
        failed = str(name) in failing
        axes.set_title(name_quantity(str(name)), loc="left", color=SYNTHETIC_COLOUR if failed else INK)
    for axes in panels.flat[len(groups) :]:
        axes.set_axis_off()
    for axes in panels[:, 0]:
        axes.set_ylabel("ECDF − uniform")
    for n, axes in enumerate(panels.flat):
        if n < len(groups) <= n + MAX_PANEL_COLUMNS:
            axes.set_xlabel("rank of the truth")
            axes.tick_params(labelbottom=True)
    label_origin(figure, is_synthetic(curves))
    return figure


def _paint_rank_panel(axes: Axes, rows: pd.DataFrame) -> None:
    place, low, high, below = (
        rows[name].to_numpy(dtype=np.float64)
        for name in ("uniform", "count_low_less_uniform", "count_high_less_uniform", "below_less_uniform")
    )
    axes.fill_between(place, low, high, color=GREY, alpha=0.22, lw=0)
    axes.axhline(0, color=GREY, lw=0.5)
    axes.step(place, below, where="post", color=ECDF_COLOUR, lw=1.0)
    outside = ~rows["passes"].to_numpy(dtype=np.bool_)
    axes.plot(place[outside], below[outside], ".", color=SYNTHETIC_COLOUR, ms=2.5)
    axes.set_xlim(0, 1)
    axes.set_xticks([0, 0.5, 1], ["0", "½", "1"])


def write_calibration(found: Calibration, folder: Path) -> list[Path]:
    """Write a calibration to `folder`, replacing an earlier result there; return the files.

    `replicates.csv` (truth, ranks, who computed them), `coverage.csv` and `ranks.csv` (what ranks say, beside
    what chance allows), `ranks.pdf`, `report.pdf`, `run.json`, `results.json.gz`, from which all of this
    can be made again, and `timing.json`, the only one with a time.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as new:
        for name in ("replicates", "coverage"):
            write_csv(getattr(found, name).assign(origin=found.origin), new / f"{name}.csv")
        figure = draw_ranks(found, new / "ranks.pdf")
        (new / "report.pdf").write_bytes(compile_pdf(_compose_report(found, figure)))
        store_calibration(found, new)
        write_json(new / "run.json", {**found.run, **_outcome_values(found)})
        write_json(new / "timing.json", {"seconds": found.seconds})
    return sorted(folder.iterdir())


def calibration_to_json(found: Calibration) -> dict[str, Any]:
    """Return the calibration as JSON values."""
    about = {"name": found.name, "origin": found.origin, "dataset": found.dataset_title}
    warnings = to_rows(read_warnings(found.run))
    return {
        **about,
        **_outcome_values(found),
        WARNINGS_KEY: warnings,
        "sentences": summarize_calibration(found),
        "coverage": to_records(found.coverage),
    }


def _outcome_values(found: Calibration) -> dict[str, Any]:
    return {
        "control": found.control,
        "passes": found.passes,
        "not_calibrated": found.failing,
        "draw_source": found.replicates["draw_source"].value_counts().to_dict(),
        "untrusted": found.untrusted,
        "redrawn": int(found.replicates["redrawn"].sum()),
        "interrupted": found.interrupted,
    }


def _compose_report(found: Calibration, figure: Path) -> Document:
    synthetic = found.origin == "synthetic"
    blocks = (
        *([] if found.passes else [document.warning(summarize_calibration(found)[0])]),
        *document.run_warning_blocks(found.run, found.name),
        document.bullets(summarize_calibration(found)),
        document.table(lay_out_calibration(found), synthetic),
        document.figure(figure, describe_figure(found), synthetic),
        document.text(SCOPE_NOTE),
    )
    return Document(f"Calibration: {found.title}", found.dataset_title, synthetic, blocks)
