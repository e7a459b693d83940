"""`needlefit view SCAN`: what a reconstruction finds in a scan, to look at and to correct."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlefit.cli.options import scan_option
from needlefit.errors import ConfigError
from needlefit.project.input_files import is_dir, is_file, path_exists
from needlefit.project.locate import find_file, list_names

if TYPE_CHECKING:
    from needlefit.imaging.scans import Scan
    from needlefit.viewer.scan_session import ScanSession


def names_scan(target: str | None) -> bool:
    """Whether a target is a volume, or a table of scans, or its folder, with or without `/ID`."""
    if target is None:
        return False
    path = Path(target)
    if _split_table(target) is not None:
        return True
    if is_dir(path):
        return not any(is_file(path / name) for name in ("run.json", "dataset.toml"))
    if not is_file(path):
        return False
    from needlefit.imaging.volume import ARCHIVE_SUFFIX, IMAGE_SUFFIXES, begins_as_dicom

    return path.name.lower().endswith((*IMAGE_SUFFIXES, ARCHIVE_SUFFIX)) or begins_as_dicom(path)


def open_session(target: str, named: Mapping[str, Any], recipe: str | None, folder: Path) -> "ScanSession":
    """Return the session of a scan; corrections are saved to a folder of its name in `folder`.

    Parameters
    ----------
    named : mapping
        Files of a volume, by their keywords of `make_scans`.
    recipe : str or None
        None: `recipe.toml` in a folder with a table of scans, else the default.

    Raises
    ------
    ConfigError, DataError
        If there is no such scan, or its files have a fault.
    """
    from needlefit.project.load import load
    from needlefit.schemas.reconstruction import ReconstructionRecord
    from needlefit.viewer.scan_session import ScanSession

    scan = _find_scan(target, named)
    file = find_file("reconstruction", recipe or _find_own_recipe(target) or "default")
    return ScanSession(scan, load(file, ReconstructionRecord), file, folder / scan.id)


def _find_own_recipe(target: str) -> str | None:
    """Return the recipe beside the table, where a target names their folder, with or without `/ID`."""
    folder = _find_table_folder(Path(target))
    return str(folder / "recipe.toml") if folder and is_file(folder / "recipe.toml") else None


def _find_scan(target: str, named: Mapping[str, Any]) -> "Scan":
    from needlefit.imaging.scans import make_scans, read_scans

    table = _split_table(target)
    if table is None:
        return make_scans([Path(target)], **named)[0]
    if named:
        raise ConfigError(
            "a table of scans names its own files",
            where=str(table[0]),
            fix=f"leave out {', '.join(map(scan_option, named))}, or fill its columns",
        )
    scans = read_scans(table[0])
    chosen = [one for one in scans if one.id == table[1]] if table[1] else scans
    if len(chosen) != 1:
        known = ", ".join(one.id for one in scans)
        raise ConfigError(
            f"holds no scan {table[1]!r}" if table[1] else f"holds {len(scans)} scans",
            where=str(table[0]),
            expected=f"one of {known}",
            fix=f"needlefit view {table[0]}/{scans[0].id}",
        )
    return chosen[0]


def _split_table(target: str) -> tuple[Path, str] | None:
    """Return the table of scans and the id that a path or bare name means, with or without `/ID`."""
    path = Path(target)
    if target in list_names("scans"):
        return find_file("scans", target), ""
    if path.suffix.lower() == ".csv" and is_file(path):
        return path, ""
    if path.parent.suffix.lower() == ".csv" and is_file(path.parent):
        return path.parent, path.name
    if str(path.parent) in list_names("scans"):
        return find_file("scans", str(path.parent)), path.name
    folder = _find_table_folder(path)
    if folder is not None:
        return folder / "scans.csv", "" if folder == path else path.name
    return None


def _find_table_folder(path: Path) -> Path | None:
    """Return the folder with a table of scans that a path means, with or without `/ID`.

    The table is that of refused scans or of corrections; a result or a dataset is something else.
    """
    folder = path if path_exists(path) else path.parent
    others = ("run.json", "dataset.toml")
    found = is_file(folder / "scans.csv") and not any(is_file(folder / name) for name in others)
    return folder if found else None
