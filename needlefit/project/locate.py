"""Find the file of a name: in the working folder's project, then in the copy that ships with needlefit."""

import difflib
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from needlefit.errors import ConfigError
from needlefit.project.input_files import is_dir, is_file, path_exists, read_toml
from needlefit.schemas.names import require_file_name

FileKind = Literal["scene", "recipe", "study", "fit", "medium", "dataset", "scans", "reconstruction"]

_PATTERNS: dict[FileKind, str] = {
    "scene": "configs/scenes/{name}.toml",
    "recipe": "configs/recipes/{name}.toml",
    "medium": "configs/media/{name}.toml",
    "fit": "configs/fits/{name}.toml",
    "study": "studies/{name}.toml",
    "dataset": "data/{name}/dataset.toml",
    "scans": "data/{name}/scans.csv",
    "reconstruction": "configs/reconstruction/{name}.toml",
}
PROJECT_FOLDERS = ("data", "configs", "studies")
EVERY_STUDY = "everything"  # every study there is, as `all` means those of the paper
PAPER_STUDIES = ("study1", "study2", "study3", "study4", "study5")
PAPER_FITS = ("phantom1", "phantom2", "phantom3", "chicken")
MAX_LISTED_NAMES = 40  # names that a message lists, the nearest first
STUDY_GROUPS = ("all", EVERY_STUDY)
"""Names of several studies, and the fits of the paper's tuning tables with them, reported together."""


def shipped_folder() -> Path:
    """Return the folder that holds the shipped `data/ configs/ studies/`."""
    package = Path(__file__).resolve().parent.parent
    wheel = package / "_shipped"
    return wheel if is_dir(wheel) else package.parent


def search_roots() -> tuple[Path, ...]:
    """Return the folders searched for a bare name, in order; each name is looked up on its own.

    A working folder that holds only some of `data/ configs/ studies/`, or only some names, is completed
    by the shipped ones.
    """
    here = Path.cwd()
    local = here != shipped_folder() and any(is_dir(here / part) for part in PROJECT_FOLDERS)
    return (here, shipped_folder()) if local else (shipped_folder(),)


def list_names(kind: FileKind) -> list[str]:
    """Return every bare name of a kind, sorted."""
    pattern = _PATTERNS[kind]
    return sorted(
        {_name(kind, path) for root in search_roots() for path in root.glob(pattern.format(name="*"))}
    )


def find_file(kind: FileKind, name: str) -> Path:
    """Return the file that `name` means: a path (holds `/` or ends in `.toml`) or a bare name.

    ConfigError if there is no such file; the nearest names are listed.
    """
    if is_path(name):
        path = Path(name)
        path = path / "dataset.toml" if kind == "dataset" and is_dir(path) else path
        if is_file(path):
            return path
        if kind == "dataset" and is_dir(Path(name)):
            raise ConfigError(
                "this folder holds no dataset.toml",
                where=name,
                expected="dataset.toml: what the dataset is, and which files hold what",
                fix="name the folder that holds it; `needlefit new dataset DIR` writes one to begin with",
            )
        raise _missing_error(kind, name)
    for root in search_roots():
        path = root / _PATTERNS[kind].format(name=name)
        if is_file(path):
            return path
    raise unknown_name_error(kind, name, list_names(kind))


def file_label(path: Path) -> str:
    """Return how messages call a file: a shipped one by its name, the user's own by its path."""
    root = shipped_folder()
    if Path.cwd() != root and path.is_relative_to(root):
        for kind, pattern in _PATTERNS.items():
            if path.relative_to(root).match(pattern.format(name="*")):
                return f"{kind} {_name(kind, path)} (shipped)"
    return str(path)


def find_study_or_fit(name: str) -> tuple[Literal["study", "fit"], Path]:
    """Return the study or the fit that `name` means; a name found as both is an error."""
    if is_path(name):
        path = Path(name)
        if not is_file(path):
            raise _missing_error("study or fit", name)
        require_file_name(path.stem, name)
        return ("study" if _is_study(path) else "fit"), path
    kinds: tuple[Literal["study", "fit"], ...] = ("study", "fit")
    found = [kind for kind in kinds if name in list_names(kind)]
    if len(found) == 2:
        raise ConfigError(
            f"`{name}` is both a study and a fit",
            fix=f"say which: studies/{name}.toml or configs/fits/{name}.toml",
        )
    if not found and name == "all":
        raise ConfigError(
            "`all` is no study or fit that can be tuned by itself",
            expected=f"one of {', '.join([*list_names('study'), *list_names('fit')])}",
            fix="tune them one by one; `needlefit validate all` runs the paper's studies and their fits",
        )
    if not found:
        raise unknown_name_error("study or fit", name, list_names("study") + list_names("fit"))
    return found[0], find_file(found[0], name)


_DATASET_KEYS = {"origin", "needle", "insertions", "centerlines", "tip_tracks"}


def find_dataset_or_study(name: str) -> tuple[Literal["dataset", "study", "fit"], Path]:
    """Return the dataset, or else the study or fit, that `name` means; ConfigError if there is none."""
    if is_path(name):
        path = find_file("dataset", name)
        if path.suffix == ".csv":
            fix = f"needlefit check {path.with_name('dataset.toml')}"
            raise ConfigError("is a table of a dataset", where=name, expected="its dataset.toml", fix=fix)
        keys = read_toml(path, where=file_label(path)).keys()
        if path.name != "dataset.toml" and _is_study(path):
            return "study", path
        if path.name == "dataset.toml" or keys & _DATASET_KEYS:
            return "dataset", path
        if {"dataset", "medium"} <= keys:
            return "fit", path
        raise ConfigError(
            "is neither a dataset nor a study",
            where=name,
            expected="a dataset, a study or a fit",
            fix="check the study that names it: its tissue model and its recipe are checked, too",
        )
    kinds: tuple[Literal["dataset", "study", "fit"], ...] = ("dataset", "study", "fit")
    known = {kind: list_names(kind) for kind in kinds}
    for kind in kinds:
        if name in known[kind]:
            return kind, find_file(kind, name)
    raise unknown_name_error("dataset or study", name, [one for names in known.values() for one in names])


def find_studies(name: str) -> list[tuple[str, Path]]:
    """Return the names and files of the studies that `name` means; `all` is the paper's five.

    Studies on data that is not shipped are never among `all`; `everything` has all studies, these too.
    """
    if name in STUDY_GROUPS:
        others = [one for one in list_names("study") if one not in PAPER_STUDIES]
        wanted = (*PAPER_STUDIES, *(others if name == EVERY_STUDY else ()))
        return [(study, find_file("study", study)) for study in wanted]
    known = list_names("study")
    if not is_path(name) and name not in known:
        if name in list_names("fit"):
            raise _not_a_study_error(name)
        raise unknown_name_error("study", name, [*known, *STUDY_GROUPS])
    path = find_file("study", name)
    if path.parent.name == "fits" and not _is_study(path):
        raise _not_a_study_error(name)
    require_file_name(path.stem, name)
    return [(path.stem, path)]


def find_tunings(name: str) -> list[tuple[str, Path]]:
    """Return the names and files of the fits that fill the paper's tuning tables, which belong to a group."""
    return [(fit, find_file("fit", fit)) for fit in PAPER_FITS] if name in STUDY_GROUPS else []


def find_run(name: str) -> Path:
    """Return the folder of results that `name` means: a path, or bare a folder in `reports/`.

    ConfigError if there is no such folder, or it holds no `run.json`.
    """
    folder = Path(name) if is_path(name) else Path("reports") / name
    if is_file(folder / "run.json"):
        return folder
    raise unknown_name_error("run", name, list_runs())


def list_runs() -> list[str]:
    """Return the names of the folders of results in `reports/`, sorted."""
    return sorted(path.parent.name for path in Path("reports").glob("*/run.json"))


def is_path(name: str) -> bool:
    """Return whether a name is a path, and no bare name to look up."""
    return "/" in name or name in (".", "..") or name.endswith(".toml")


def _is_study(path: Path) -> bool:
    return bool(
        {"validate", "leave_out", "observable", "kind"} & read_toml(path, where=file_label(path)).keys()
    )


def _name(kind: FileKind, path: Path) -> str:
    return path.parent.name if kind in ("dataset", "scans") else path.stem


def _not_a_study_error(fit: str) -> ConfigError:
    return ConfigError(
        f"`{fit}` is a fit, which has nothing to validate on",
        expected="a study",
        fix=f"use: {shlex.join(('needlefit', 'tune', fit))}",
    )


def _missing_error(kind: str, name: str) -> ConfigError:
    path = Path(name)
    if not is_dir(path.parent):
        there = f"the folder {path.parent} does not exist"
    else:
        files = [str(file) for file in path.parent.glob("*.toml") if file.is_file()]
        there = join_names(sort_by_similarity(name, files)) or "no TOML file in this folder"
    return ConfigError(
        f"there is no such {kind}",
        where=name,
        expected=f"a TOML file: {there}",
        fix="check the path",
    )


def unknown_name_error(kind: str, name: str, known: list[str], otherwise: str = ", or a path") -> ConfigError:
    """Return what is raised of a bare name that is not known: those that are, the nearest first."""
    fix = f"write ./{name} if you mean the one in this folder" if path_exists(Path(name)) else ""
    return ConfigError(
        f"there is no {kind} called `{name}`",
        expected=f"one of {join_names(sort_by_similarity(name, known)) or '(none found)'}",
        fix=fix or f"use one of these names{otherwise}",
    )


def sort_by_similarity(name: str, known: Iterable[str]) -> list[str]:
    """Return names, each once, those most like `name` first, equally like ones by the alphabet."""
    wanted = difflib.SequenceMatcher(b=name.lower(), autojunk=False)

    def likeness(one: str) -> float:
        wanted.set_seq1(one.lower())
        return wanted.ratio()

    return sorted(sorted(set(known)), key=likeness, reverse=True)


def join_names(names: Sequence[str], most: int = MAX_LISTED_NAMES) -> str:
    """Return names as a message lists them, no more than `most`."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


# --- what a name of the viewer means ---------------------------------------------------------------------

TargetKind = Literal["scene", "run", "dataset"]
SpecimenChoice = Literal["shown", "planned", "new", "same"]
"""Specimen that a run's draws are for: the shown insertion's, as the run predicted it; a planned one's, which
is new unless the run's study leaves out the spread between specimens; a new one; one that was fitted."""


@dataclass(frozen=True)
class ViewTarget:
    """What a name means."""

    kind: TargetKind
    name: str  # what it is called, without an insertion
    path: Path  # the scene's file, the run's folder, or the `dataset.toml`
    insertion: str | None = None  # the insertion that was named with a run or a dataset
    specimen: SpecimenChoice = "shown"  # of the draws of a run


def find_view_target(name: str) -> ViewTarget:
    """Return the scene, run or dataset that `name` means; behind a run or dataset may stand `/ID`.

    ConfigError if there is nothing of that name, or things of several kinds.
    """
    whole = _find_viewed(name)
    if whole is not None:
        return whole
    with_insertions = sorted({*list_names("dataset"), *list_runs()})
    if "/" not in name:
        known = sorted({*list_names("scene"), *with_insertions})
        raise unknown_name_error("scene, run or dataset", name, known)
    front, _, insertion = name.rstrip("/").rpartition("/")
    found = _find_viewed(front, insertion)
    if found is not None and found.kind != "scene":
        return replace(found, insertion=insertion)
    if front and not is_path(front) and not path_exists(Path(name)):
        raise unknown_name_error("dataset or run", front, with_insertions)
    raise ConfigError(
        "holds no scene, run or dataset",
        where=name,
        expected="a scene (.toml), a folder with run.json or dataset.toml, or such a folder and /ID",
        fix="check the path",
    )


def _find_viewed(name: str, insertion: str | None = None) -> ViewTarget | None:
    """Return what a path or a bare name means, None if nothing; a name of several kinds is an error."""
    at, found = Path(name), dict[TargetKind, Path]()
    if is_path(name):
        if name.endswith(".toml") and at.name != "dataset.toml":
            found["scene"] = find_file("scene", name)
        elif is_dir(at) and is_file(at / "run.json"):
            found["run"] = at
        elif at.name == "dataset.toml" or is_file(at / "dataset.toml"):
            found["dataset"] = find_file("dataset", name)
    else:
        if insertion is None and name in list_names("scene"):  # a scene has no insertions
            found["scene"] = find_file("scene", name)
        if name in list_runs():
            found["run"] = find_run(name)
        if name in list_names("dataset"):
            found["dataset"] = find_file("dataset", name)
    if len(found) > 1:
        here, more = Path.cwd(), "" if insertion is None else f"/{insertion}"
        paths = [path.parent if kind == "dataset" else path for kind, path in found.items()]
        shown = [f"{one.relative_to(here) if one.is_relative_to(here) else one}{more}" for one in paths]
        raise ConfigError(
            f"`{name}` is {' and '.join(f'a {kind}' for kind in found)}",
            fix=f"say which: {' or '.join(shown)}",
        )
    return next((ViewTarget(kind, name, path) for kind, path in found.items()), None)
