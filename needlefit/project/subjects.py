"""What a name on the command line can mean that has a needle to show: a scene, a run, or a dataset."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from needlefit.errors import ConfigError
from needlefit.project.places import find, find_run, is_path, names, run_names, unknown_name
from needlefit.project.reading import is_dir, is_file, is_there

Kind = Literal["scene", "run", "dataset"]


@dataclass(frozen=True)
class Named:
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
    """

    kind: Kind
    name: str
    path: Path
    insertion: str | None = None


def find_subject(name: str) -> Named:
    """Return the scene, run or dataset that `name` means; behind a run or dataset may stand `/ID`.

    Raises
    ------
    ConfigError
        If there is nothing of that name, or things of several kinds.
    """
    whole = _at(name) if is_path(name) else _called(name)
    if whole is not None:
        return whole
    if "/" not in name:
        raise unknown_name("scene, run or dataset", name, sorted({*names("scene"), *_with_insertions()}))
    front, _, insertion = name.rstrip("/").rpartition("/")
    found = _at(front) if is_path(front) else _called(front, insertion)
    if found is not None and found.kind != "scene":
        return Named(found.kind, found.name, found.path, insertion)
    if front and not is_path(front) and not is_there(Path(name)):
        raise unknown_name("dataset or run", front, _with_insertions())
    raise ConfigError(
        "holds no scene, run or dataset",
        where=name,
        expected="a scene (.toml), a folder with run.json or dataset.toml, or such a folder and /ID",
        mend="check the path",
    )


def _with_insertions() -> list[str]:
    return sorted({*names("dataset"), *run_names()})


def _at(path: str) -> Named | None:
    """Return what stands at a path, None if nothing that can be shown does."""
    at = Path(path)
    if path.endswith(".toml") and at.name != "dataset.toml":
        return Named("scene", path, find("scene", path))
    if is_dir(at) and is_file(at / "run.json"):
        return Named("run", path, at)
    if at.name == "dataset.toml" or is_file(at / "dataset.toml"):
        return Named("dataset", path, find("dataset", path))
    return None


def _called(name: str, insertion: str | None = None) -> Named | None:
    """Return what has a bare name; a scene has no insertions. Several kinds are an error."""
    found: dict[Kind, Path] = {}
    if insertion is None and name in names("scene"):
        found["scene"] = find("scene", name)
    if name in run_names():
        found["run"] = find_run(name)
    if name in names("dataset"):
        found["dataset"] = find("dataset", name)
    if len(found) > 1:
        more = "" if insertion is None else f"/{insertion}"
        paths = [_from_here(path.parent if kind == "dataset" else path) for kind, path in found.items()]
        raise ConfigError(
            f"`{name}` is {' and '.join(f'a {kind}' for kind in found)}",
            mend=f"say which: {' or '.join(f'{path}{more}' for path in paths)}",
        )
    return next((Named(kind, name, path) for kind, path in found.items()), None)


def _from_here(path: Path) -> str:
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
