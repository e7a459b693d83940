"""Find the scene, run or dataset that a name on the command line means."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from needlefit.errors import ConfigError
from needlefit.project.input_files import is_dir, is_file, path_exists
from needlefit.project.locate import find_file, find_run, is_path, list_names, list_runs, unknown_name_error

TargetKind = Literal["scene", "run", "dataset"]
SpecimenChoice = Literal["shown", "planned", "new", "same"]
"""Specimen that a run's draws are for: the shown insertion's, as the run predicted it; a planned one's, which
is new unless the run's study leaves out the spread between specimens; a new one; one that was fitted."""


@dataclass(frozen=True)
class ViewTarget:
    """What a name means.

    Attributes
    ----------
    kind : "scene", "run" or "dataset"
    name : str
        What it is called, without an insertion.
    path : Path
        The scene's file, the run's folder, or the `dataset.toml`.
    insertion : str or None
        The insertion that was named with a run or a dataset.
    specimen : SpecimenChoice
        Of the draws of a run.
    """

    kind: TargetKind
    name: str
    path: Path
    insertion: str | None = None
    specimen: SpecimenChoice = "shown"


def find_view_target(name: str) -> ViewTarget:
    """Return the scene, run or dataset that `name` means; behind a run or dataset may stand `/ID`.

    Raises
    ------
    ConfigError
        If there is nothing of that name, or things of several kinds.
    """
    whole = _find_at_path(name) if is_path(name) else _find_by_name(name)
    if whole is not None:
        return whole
    if "/" not in name:
        raise unknown_name_error(
            "scene, run or dataset", name, sorted({*list_names("scene"), *_list_with_insertions()})
        )
    front, _, insertion = name.rstrip("/").rpartition("/")
    found = _find_at_path(front) if is_path(front) else _find_by_name(front, insertion)
    if found is not None and found.kind != "scene":
        return ViewTarget(found.kind, found.name, found.path, insertion)
    if front and not is_path(front) and not path_exists(Path(name)):
        raise unknown_name_error("dataset or run", front, _list_with_insertions())
    raise ConfigError(
        "holds no scene, run or dataset",
        where=name,
        expected="a scene (.toml), a folder with run.json or dataset.toml, or such a folder and /ID",
        fix="check the path",
    )


def _list_with_insertions() -> list[str]:
    return sorted({*list_names("dataset"), *list_runs()})


def _find_at_path(path: str) -> ViewTarget | None:
    """Return what stands at a path, None if nothing that can be shown does."""
    at = Path(path)
    if path.endswith(".toml") and at.name != "dataset.toml":
        return ViewTarget("scene", path, find_file("scene", path))
    if is_dir(at) and is_file(at / "run.json"):
        return ViewTarget("run", path, at)
    if at.name == "dataset.toml" or is_file(at / "dataset.toml"):
        return ViewTarget("dataset", path, find_file("dataset", path))
    return None


def _find_by_name(name: str, insertion: str | None = None) -> ViewTarget | None:
    """Return what has a bare name; a scene has no insertions. Several kinds are an error."""
    found: dict[TargetKind, Path] = {}
    if insertion is None and name in list_names("scene"):
        found["scene"] = find_file("scene", name)
    if name in list_runs():
        found["run"] = find_run(name)
    if name in list_names("dataset"):
        found["dataset"] = find_file("dataset", name)
    if len(found) > 1:
        more = "" if insertion is None else f"/{insertion}"
        paths = [_relative_path(path.parent if kind == "dataset" else path) for kind, path in found.items()]
        raise ConfigError(
            f"`{name}` is {' and '.join(f'a {kind}' for kind in found)}",
            fix=f"say which: {' or '.join(f'{path}{more}' for path in paths)}",
        )
    return next((ViewTarget(kind, name, path) for kind, path in found.items()), None)


def _relative_path(path: Path) -> str:
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
