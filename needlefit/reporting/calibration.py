"""Simulation-based calibration: as files, and for machines."""

from pathlib import Path
from typing import Any

from needlefit.project.atomic_write import replace_folder
from needlefit.project.result_warnings import WARNINGS_KEY, read_warnings, to_rows
from needlefit.reporting import document
from needlefit.reporting.calibration_said import PROVES, caption, layout, said
from needlefit.reporting.document import Document, compile_pdf
from needlefit.reporting.figures.ranks import draw_ranks
from needlefit.reporting.files import write_csv, write_json
from needlefit.reporting.tables import records
from needlefit.validation.calibration.run import Calibration, store_calibration


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
        (new / "report.pdf").write_bytes(compile_pdf(_page(found, figure)))
        store_calibration(found, new)
        write_json(new / "run.json", {**found.run, **_outcome(found)})
        write_json(new / "timing.json", {"seconds": found.seconds})
    return sorted(folder.iterdir())


def as_json(found: Calibration) -> dict[str, Any]:
    """Return the result for machines."""
    about = {"name": found.name, "origin": found.origin, "dataset": found.dataset_title}
    warnings = to_rows(read_warnings(found.run))
    return {
        **about,
        **_outcome(found),
        WARNINGS_KEY: warnings,
        "said": said(found),
        "coverage": records(found.coverage),
    }


def _outcome(found: Calibration) -> dict[str, Any]:
    return {
        "control": found.control,
        "passes": found.passes,
        "not_calibrated": found.failing,
        "draw_source": found.replicates["draw_source"].value_counts().to_dict(),
        "untrusted": found.untrusted,
        "redrawn": int(found.replicates["redrawn"].sum()),
        "interrupted": found.interrupted,
    }


def _page(found: Calibration, figure: Path) -> Document:
    synthetic = found.origin == "synthetic"
    blocks = (
        *([] if found.passes else [document.warning(said(found)[0])]),
        *document.warnings_in(found.run, found.name),
        document.bullets(said(found)),
        document.table(layout(found), synthetic),
        document.figure(figure, caption(found), synthetic),
        document.text(PROVES),
    )
    return Document(f"Calibration: {found.title}", found.dataset_title, synthetic, blocks)
