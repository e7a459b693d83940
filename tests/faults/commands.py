"""The commands that are spoiled, each with inputs so small that a run takes a second or two."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

SHIPPED = Path(__file__).resolve().parents[2]
SCANS = SHIPPED / "data" / "sample_scan" / "scans.csv"

RECIPE = """\
schema = 1
algorithm = "leastsquares"
starts = 2
seed = 1
evaluations = 60
tolerance = 1e-2

[sample]
walkers = 8
densities = 480
"""

FIT = """\
schema = 1
dataset = "twin"
medium = "chicken"
recipe = "tiny"

[tune]
insertions = ["chicken-04", "chicken-10"]
"""

STUDY = """\
schema = 1
title = "Tiny"
paper_study = 2
dataset = "twin"
medium = "phantom2"
recipe = "tiny"
paper_parameters = "study2"
tune = { insertions = ["phantom2-16"] }
validate = [{ insertions = ["phantom2-15"] }]
"""

ANALYSIS = """\
schema = 1
kind = "cohort"
title = "Tiny"
datasets = ["twin"]
medium = "chicken"
recipe = "tiny"
groups = "insertion"
tune = { insertions = ["chicken-04", "chicken-10"] }
"""

INPUTS: Mapping[str, str] = {
    "configs/recipes/tiny.toml": RECIPE,
    "configs/fits/tiny_fit.toml": FIT,
    "studies/tiny.toml": STUDY,
    "studies/tiny_cohort.toml": ANALYSIS,
}

FOREIGN: Mapping[str, str] = {
    "reports/notes.txt": "mine\n",
    "reports/tiny_fit.partial-mine/data.csv": "a,b\n1,2\n",
    "reports/.hidden": "mine\n",
    "mydata.txt": "mine\n",
    ".mydata.needlefit-mine/keep.txt": "mine\n",
}
"""Files of a user beside all that is written; none may change."""


@dataclass(frozen=True)
class Command:
    """A command, the folder of its result, and the commands before it that leave another result there.

    One that does not go on with `--resume` is run again.
    """

    words: tuple[str, ...]
    out: str
    earlier: tuple[tuple[str, ...], ...]
    resumes: bool = True


_TUNE = ("tune", "tiny_fit", "--jobs", "1", "-q")
_VALIDATE = ("validate", "tiny", "--jobs", "1", "-q")
_ANALYSE = ("validate", "tiny_cohort", "--jobs", "1", "-q")
_REPORT = ("report", "tiny", "--out", "reports/again", "-q")
_RECONSTRUCT = ("reconstruct", str(SCANS), "--out", "mydata", "--jobs", "1", "-q")

COMMANDS: Mapping[str, Command] = {
    "tune": Command(_TUNE, "reports/tiny_fit", ((*_TUNE, "--seed", "3"),)),
    "validate": Command(_VALIDATE, "reports/tiny", ((*_VALIDATE, "--seed", "2"),)),
    "analysis": Command(_ANALYSE, "reports/tiny_cohort", ((*_ANALYSE, "--seed", "2"),)),
    "report": Command(
        _REPORT,
        "reports/again",
        ((*_VALIDATE, "--seed", "2"), _REPORT, _VALIDATE),
        resumes=False,
    ),
    "reconstruct": Command(_RECONSTRUCT, "mydata", ((*_RECONSTRUCT, "--title", "Before"),)),
}
"""Every kind of command that writes a folder, by its name."""


def write_inputs(folder: Path) -> None:
    for name, text in (INPUTS | FOREIGN).items():  # type: ignore[operator]
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
