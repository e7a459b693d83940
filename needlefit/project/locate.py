"""Find the file of a name: in the working folder's project, then in the copy that ships with needlefit."""

import difflib
import glob
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

from needlefit.errors import ConfigError
from needlefit.project.input_files import MAX_CONFIG_BYTES, is_dir, is_file, parse_toml, read_text
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
EVERY_STUDY = "all"  # name of the studies of the paper and the fits of its tuning tables, reported together
PAPER_STUDIES = ("study1", "study2", "study3", "study4", "study5")
PAPER_FITS = ("phantom1", "phantom2", "phantom3", "chicken")
MAX_LISTED_NAMES = 40  # largest number of names that a message lists, the nearest first


@cache
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
    path = _look_up(kind, name)
    if path is None:
        raise unknown_name_error(kind, name, list_names(kind))
    return path


def _look_up(kind: FileKind, name: str) -> Path | None:
    """Return the file that `name` means, None if there is none; a dataset may be named by its folder."""
    if is_path(name):
        path = Path(name)
        path = path / "dataset.toml" if kind == "dataset" and is_dir(path) else path
        return path if is_file(path) else None
    paths = (root / _PATTERNS[kind].format(name=name) for root in search_roots())
    return next(filter(is_file, paths), None)


def file_label(path: Path) -> str:
    """Return how messages call a file: a shipped one by its name, the user's own by its path."""
    root = shipped_folder()
    if Path.cwd() != root and path.is_relative_to(root):
        shipped = path.relative_to(root)
        for kind, pattern in _PATTERNS.items():
            if shipped.match(pattern.format(name="*")):
                return f"{kind} {_name(kind, path)} (shipped)"
    return str(path)


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; ConfigError if it cannot be read, or is none."""
    label = file_label(path)
    return parse_toml(read_text(path, MAX_CONFIG_BYTES, ConfigError, label), label)


SourceKind = Literal["dataset", "study", "fit"]
_KEYS: tuple[tuple[SourceKind, frozenset[str]], ...] = (
    ("study", frozenset({"validate", "leave_out", "folds", "kind", "question"})),
    ("dataset", frozenset({"origin", "needle", "insertions", "centerlines", "tip_tracks"})),
)
"""Keys by which the kind of a file is known that a path names; one with none of them is a fit."""


def _find_sources(name: str, kinds: Sequence[SourceKind]) -> list[tuple[SourceKind, Path]]:
    """Return what a name means among these kinds of file, in their order; of a path, what its file is."""
    sources = [(kind, path) for kind in kinds if (path := _look_up(kind, name)) is not None]
    if not sources or not is_path(name):
        return sources
    path = sources[0][1]
    keys = read_toml(path).keys()
    if path.name != "dataset.toml":
        require_file_name(path.stem, name)
        return [(next((kind for kind, some in _KEYS if keys & some), "fit"), path)]
    return [("dataset", path)]


def find_study_or_fit(name: str) -> tuple[Literal["study", "fit"], Path]:
    """Return the study or the fit that `name` means; a name found as both is an error."""
    sources = _find_studies("study or fit", name, [*list_names("study"), *list_names("fit")])
    if len(sources) == 2:
        raise ConfigError(
            f"`{name}` is both a study and a fit",
            fix=f"state which: studies/{name}.toml or configs/fits/{name}.toml",
        )
    return ("study" if sources[0][0] == "study" else "fit"), sources[0][1]


def _find_studies(kind: str, name: str, names: list[str]) -> list[tuple[SourceKind, Path]]:
    """Return the study and the fit of a name; ConfigError if it is none, with the studies of a dataset."""
    sources, path = _find_sources(name, ("study", "fit")), _look_up("dataset", name)
    if path is not None and (not sources or sources[0][0] == "dataset"):
        studies = [str(study) for study in sorted(path.parent.glob("*_study.toml"))]
        fix = f"name {' or '.join(studies)}" if studies else "write a study of it (needlefit explain study)"
        raise ConfigError("is a dataset", expected=f"a {kind}", fix=fix, where=name)
    if not sources:
        raise unknown_name_error(kind, name, names)
    return sources


def find_dataset_or_study(name: str) -> tuple[SourceKind, Path]:
    """Return the dataset, or else the study or fit, that `name` means; ConfigError if there is none."""
    if name.lower().endswith(".csv"):
        near = [folder / "dataset.toml" for folder in Path(name).parents[:2]]
        file = next(filter(is_file, near), None)
        command = f"import {shlex.quote(name)}" if file is None else f"check {shlex.quote(str(file))}"
        raise ConfigError("is a table", expected="a dataset.toml", fix=f"needlefit {command}", where=name)
    kinds: tuple[SourceKind, ...] = ("dataset", "study", "fit")
    sources = _find_sources(name, kinds)
    if not sources:
        raise unknown_name_error(
            "dataset or study", name, [name for kind in kinds for name in list_names(kind)]
        )
    return sources[0]


def find_studies(name: str) -> list[tuple[str, Path]]:
    """Return the names and files of the studies that `name` means; `all` is the paper's five."""
    if name == EVERY_STUDY:
        return [(study, find_file("study", study)) for study in PAPER_STUDIES]
    kind, path = _find_studies("study", name, [*list_names("study"), EVERY_STUDY])[0]
    if kind == "fit":
        raise ConfigError(
            f"`{name}` is a fit, which has nothing to validate on",
            expected="a study",
            fix=f"use: {shlex.join(('needlefit', 'tune', name))}",
        )
    return [(path.stem, path)]


def find_run(name: str) -> Path:
    """Return the folder of results that `name` means: a path, or bare a folder in `reports/` or here.

    A folder that holds one run means that run; ConfigError if there is none, or if it holds several.
    """
    if (folder := _look_up_run(name)) is not None:
        return folder
    inside = sorted(folder.parent for folder in Path(name).glob("*/run.json")) if is_dir(Path(name)) else []
    if len(inside) > 1:
        listed = join_names([str(folder) for folder in inside])
        raise ConfigError(f"`{name}` holds several runs", expected=f"one of {listed}")
    if not inside:
        raise unknown_name_error("run", name, list_runs())
    return inside[0]


def _look_up_run(name: str) -> Path | None:
    bare = name.rstrip("/")  # `a/` is a bare name, too
    places = [Path(name)] if is_path(bare) or not bare else [Path("reports") / bare, Path(bare)]
    return next((place for place in places if is_file(place / "run.json")), None)


def list_runs() -> list[str]:
    """Return the names of the folders of results in `reports/`, sorted."""
    return sorted(path.parent.name for path in Path("reports").glob("*/run.json"))


def is_path(name: str) -> bool:
    """Return whether a name is a path, and no bare name to look up."""
    return "/" in name or name in (".", "..") or name.endswith(".toml")


def format_path(path: Path) -> str:
    """Return a path as a command takes it: for no name."""
    is_marked = path.is_absolute() or path == Path() or path.parts[0] == ".."
    return str(path) if is_marked else f"./{path}"


def _name(kind: FileKind, path: Path) -> str:
    return path.parent.name if kind in ("dataset", "scans") else path.stem


MIN_LIKENESS = 0.7  # smallest likeness, 0 to 1, of a name that is proposed


def unknown_name_error(kind: str, name: str, names: list[str], otherwise: str = ", or a path") -> ConfigError:
    """Return what is raised of a name that is not known: those that are, the nearest first.

    `otherwise`: what may stand in place of a name; where that is a path, files and folders are looked at.
    """
    last = name.rstrip("/").rpartition("/")[2].removesuffix(".toml")
    nearest = sort_by_similarity(last, names)
    candidates = [*(_list_beside(name) if otherwise else ()), *nearest[:1]]
    best = max(candidates, key=lambda path: _compare_stems(name, path), default="")
    problem = f"there is no {kind} {'at' if is_path(name) else 'called'} `{name}`"
    if best and _compare_stems(name, best) >= MIN_LIKENESS:
        problem += f"; did you mean `{best}`?"
    listed = join_names(nearest, MAX_NEAR_NAMES) or "(none found)"
    fix = (
        "correct the path, or use one of these names"
        if is_path(name)
        else f"use one of these names{otherwise}"
    )
    return ConfigError(problem, expected=f"one of {listed}", fix=fix)


MAX_NEAR_NAMES = 8  #: largest number of existing names that are listed where a name is not found


def _list_beside(name: str) -> list[str]:
    """Return the paths in the folder of a path, or here and one folder deeper for a name."""
    folder, suffix = (Path(name).parent, Path(name).suffix) if is_path(name) else (Path(), "")
    try:
        found = [*folder.glob(f"*{glob.escape(suffix)}"), *([] if is_path(name) else folder.glob("*/*.toml"))]
    except (OSError, ValueError):  # a name that no folder can have
        return []
    return sorted(format_path(path) for path in found if path.suffix in ("", ".toml", suffix))


def _compare_stems(name: str, other: str) -> float:
    return _compare(Path(name).name.removesuffix(".toml"), Path(other).name.removesuffix(".toml"))


def _compare(name: str, other: str) -> float:
    return difflib.SequenceMatcher(None, name.lower(), other.lower(), autojunk=False).ratio()


def sort_by_similarity(name: str, names: Iterable[str]) -> list[str]:
    """Return names, each once, those most like `name` first, equally like ones by the alphabet."""
    return sorted(sorted(set(names)), key=lambda candidate: _compare(candidate, name), reverse=True)


def join_names(names: Sequence[str], most: int = MAX_LISTED_NAMES) -> str:
    """Return names as a message lists them, no more than `most`."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


# --- what a name of the viewer means ---------------------------------------------------------------------

TargetKind = Literal["scene", "run", "dataset"]


@dataclass(frozen=True)
class ViewTarget:
    """What a name means."""

    kind: TargetKind
    name: str  # what it is called, without an insertion
    path: Path  # the scene's file, the run's folder, or the `dataset.toml`
    insertion: str | None = None  # the insertion that was named with a run or a dataset
    # that a run's draws are for: "shown": the insertion's, as the run predicted it; "planned": of a planned
    # one, new unless the study leaves out the spread between specimens; "new", "same" (as fitted), or a name
    specimen: str = "shown"
    others: tuple[tuple[TargetKind, Path], ...] = ()  # what else has the name, by its path


def find_view_target(name: str, first: TargetKind = "run") -> ViewTarget:
    """Return the scene, run or dataset that `name` means; behind a run or dataset may stand `/ID`.

    Of several the one of the kind `first`, else the run, the scene. ConfigError if there is none.
    """
    front, _, insertion = name.rstrip("/").rpartition("/")
    targets = _list_viewed(name)
    if not targets and front:
        behind = (
            target for target in _list_viewed(front) if target.kind != "scene"
        )  # a scene has no insertions
        targets = [replace(target, insertion=insertion) for target in behind]
    if not targets:
        names = {*list_names("scene"), *list_names("dataset"), *list_runs()}
        raise unknown_name_error("scene, run or dataset", name, list(names))
    order: tuple[TargetKind, ...] = (first, "run", "scene", "dataset")
    targets.sort(key=lambda target: order.index(target.kind))
    others = (
        (target.kind, target.path.parent if target.kind == "dataset" else target.path)
        for target in targets[1:]
    )
    return replace(targets[0], others=tuple(others))


def _list_viewed(name: str) -> list[ViewTarget]:
    """Return the scene, the run and the dataset of a bare name, or the one thing that a path means."""
    scene, run, dataset = _look_up("scene", name), _look_up_run(name), _look_up("dataset", name)
    if is_path(name):
        if run is not None or (scene is not None and scene.name != "dataset.toml"):
            dataset = None
        scene = scene if dataset is None else None
    elif run is not None and run.parent != Path("reports") and (scene or dataset):
        run = None
    kinds: tuple[tuple[TargetKind, Path | None], ...] = (("scene", scene), ("run", run), ("dataset", dataset))
    return [ViewTarget(kind, name, path) for kind, path in kinds if path is not None]
