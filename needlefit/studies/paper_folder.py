"""Write a folder for a paper: every figure in the widths of one and of two columns, and the LaTeX files."""

import shutil
from pathlib import Path

from needlefit.errors import ConfigError
from needlefit.reporting.document import is_half_width
from needlefit.reporting.figures.style import COLUMN_WIDTH_IN, TEXT_WIDTH_IN, fix_width
from needlefit.studies.report import compose_run_report, find_report, label_figures
from needlefit.studies.run import Run

WIDTHS_IN = {"single": COLUMN_WIDTH_IN, "double": TEXT_WIDTH_IN}
"""Width of a figure in inches, by the word at the end of its name."""


def write_paper_folder(run: Run, run_folder: Path, folder: Path) -> list[Path]:
    """Write to a new folder all figures of a run in both widths, and its LaTeX files.

    A figure that cannot be drawn in one column is there in its own width alone.

    Raises ConfigError if the folder exists and holds anything.
    """
    if folder.exists() and any(folder.iterdir()):
        raise ConfigError("is not empty", where=folder, fix="name a new folder")
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(run_folder.iterdir()):
        if path.suffix == ".tex":
            shutil.copyfile(path, folder / path.name)
    for word, width in WIDTHS_IN.items():
        with fix_width(width):
            drawn = find_report(run).draw(run, folder)
        figures = {}
        for name, path in drawn.items():
            path.with_suffix(".csv").unlink(missing_ok=True)  # the run's folder has it
            figures[name] = path.rename(path.with_stem(f"{path.stem}-{word}"))
        report = compose_run_report(run, figures)
        blocks = [block for block in report.blocks if block["kind"] == "figure"]
        kept = [block for block in blocks if is_half_width(block["path"]) == (word == "single")]
        label_figures([block["path"] for block in kept], run.origin_mark)
        for path in set(figures.values()) - {block["path"] for block in kept}:
            path.unlink()
    return sorted(folder.iterdir())
