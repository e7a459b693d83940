"""Run of earlier versions, which have no stamp: known by their `run.json`, and their files by name.

These are the names that earlier versions wrote, and those that `needlefit migrate` gave them: never rename
them.
"""

import csv
import re
from pathlib import Path

from needlefit.errors import DataError
from needlefit.project.input_files import read_json, read_text

_UNSTAMPED_STEMS = (
    r"adaptation|against|agreement|alphas|bands|beyond|boxplot|calibration|candidates|"
    r"cells|contest|contests|convergence|corner|coverage|credibility|curves|densities|"
    r"depths|design|differences|direction|directions|draws|errors|evidence|failures|fits"
    r"|forecast|foretold|gained|generalising|identification|identify|insertions|largest|"
    r"layers|left|left_out|lost|material|methods|misses|needles|next_insertion|numbers|"
    r"orders|overlays|paired|parameter_cells|parameter_changes|parameters|pattern|plane|"
    r"plans|population|posterior|predictive|profiles|profiles_design|profiles_fit|ranks|"
    r"reached|readings|recovered|references|replicates|report|residuals|rivals|run|runs"
    r"|scores|sensitivity|shapes|specimens|starts|studies|summary|timing|tips|told|"
    r"comparison|comparisons|exceedances|gains|group_differences|insertions_needed|"
    r"tuning|tuning_by_layers|tuning_by_media|validation|verification|waterfall|within"
)

_UNSTAMPED_NAMES = re.compile(
    rf"({_UNSTAMPED_STEMS})\.(csv|pdf|tex|html|json|bib)|studies_[a-z0-9_]+\.tex|results\.json\.gz|prior\.toml"
    r"|posterior(_\d+|-[^/]+)?\.nc"
)


def unstamped_files(folder: Path) -> frozenset[str]:
    """Return the names that a run of an earlier version may have written in `folder`, that are there.

    Empty where no `run.json` states the version of needlefit that wrote it: then it is not a result.
    """
    try:
        run = read_json(folder / "run.json")
    except DataError:
        return frozenset()
    if not isinstance(run, dict) or not any(_states_version(part) for part in (run, *run.values())):
        return frozenset()
    names = {path.name for path in folder.iterdir() if _UNSTAMPED_NAMES.fullmatch(path.name)}
    names |= {f"slicer/{id_}{ending}" for id_ in _scored_insertions(folder) for ending in _SLICER_ENDINGS}
    parts = [part for part in run if (folder / part).is_dir() and Path(part).name == part]
    names |= {
        f"{part}/{path.name}" for part in parts for path in (folder / part).iterdir() if _is_figure(path)
    }
    return frozenset(names)


def _states_version(run: object) -> bool:
    """Return whether the record of a run, or of one of several, says which needlefit computed it."""
    versions = run.get("versions") if isinstance(run, dict) else None
    return isinstance(versions, dict) and isinstance(versions.get("needlefit"), str)


_SLICER_ENDINGS = (".mrk.json", ".needle.ply", ".band.ply")


def _is_figure(path: Path) -> bool:
    return path.suffix in (".pdf", ".csv") and bool(_UNSTAMPED_NAMES.fullmatch(path.name))


def _scored_insertions(folder: Path) -> set[str]:
    """Return the insertions of which a run wrote errors."""
    try:
        rows = csv.DictReader(read_text(folder / "errors.csv").splitlines())
        return {row.get("insertion") or "" for row in rows}
    except (DataError, csv.Error):
        return set()
