"""`needlefit view SCAN`: what a reconstruction finds in a scan, to look at and to correct."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from needlefit.errors import ConfigError
from needlefit.project.input_files import is_dir, is_file
from needlefit.project.locate import find_file, list_names

if TYPE_CHECKING:
    from needlefit.imaging.scan import Scan
    from needlefit.viewer.scans.session import ScanSession


def names_scan(target: str | None) -> bool:
    """Whether a target is a volume, or a table of scans with or without `/ID`."""
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


def open_session(
    target: str, markers: Path | None, layers: Sequence[str], recipe: str, folder: Path
) -> "ScanSession":
    """Return the session of a scan; corrections are kept in a folder of its name in `folder`.

    Raises
    ------
    ConfigError, DataError
        If there is no such scan, or its files have a fault.
    """
    from needlefit.project.load import load
    from needlefit.schemas.reconstruction import ReconstructionRecord
    from needlefit.viewer.scans.session import ScanSession

    scan = _find_scan(target, markers, layers)
    record = load(find_file("reconstruction", recipe), ReconstructionRecord)
    return ScanSession(scan, record, recipe, folder / scan.id)


def _find_scan(target: str, markers: Path | None, layers: Sequence[str]) -> "Scan":
    from needlefit.imaging.scan_table import make_scans, read_scans

    table = _split_table(target)
    if table is None:
        return make_scans([Path(target)], markers=markers, layers=layers)[0]
    if markers is not None or layers:
        raise ConfigError(
            "a table of scans names its own markers and layers",
            where=str(table[0]),
            fix="leave out --markers and --layers, or fill its columns",
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
    return None
