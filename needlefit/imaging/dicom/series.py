"""Which series of a folder is meant."""

import re
from pathlib import Path

from needlefit.errors import DataError
from needlefit.imaging.dicom.header import Slice, damaged, is_dicom, read_header
from needlefit.project.reading import is_file

LOCALIZER = "LOCALIZER"
_SHOWN = 10


def find_series(path: Path, series: str | None = None) -> list[Slice]:
    """Return the slices of the one series that `path` means, in no order.

    Parameters
    ----------
    path : Path
        A folder, or one file of a series in it.
    series : str, optional
        Number or UID of the series, where a folder holds several.

    Raises
    ------
    DataError
        If there is no DICOM image there, no series of the name, or several to choose from.
    """
    if is_file(path):
        return _of_file(path)
    groups = _groups(path)
    if not groups:
        raise _nothing(path)
    if series is not None:
        return _named(path, groups, series)
    stacks = {uid: slices for uid, slices in groups.items() if _may_be_volume(slices)} or groups
    if len(stacks) > 1:
        raise DataError(
            f"holds {len(stacks)} series: {_list(stacks)}",
            where=str(path),
            expected="one series, or the name of the one that is meant",
            mend="give the number or the UID of the one that is meant with --series, or under `series` in a "
            "table of scans",
        )
    return next(iter(stacks.values()))


def _of_file(path: Path) -> list[Slice]:
    header = read_header(path)
    if header is None:
        raise DataError(
            "is not a volume that can be read",
            where=str(path),
            expected="a DICOM image, or a file that ends in .nrrd, .nii, .nii.gz or .mha",
            mend="export the scan in one of these formats",
        )
    return _groups(path.parent)[header.series]


def _groups(folder: Path) -> dict[str, list[Slice]]:
    """Return the slices of every series in `folder`, by UID; the same order on every machine.

    Raises
    ------
    DataError
        If a slice is damaged: so is a file named as the others are, by a number, that is no DICOM file.
    """
    groups: dict[str, list[Slice]] = {}
    others: list[Path] = []
    for file in sorted(file for file in folder.iterdir() if is_file(file) and file.name[0] != "."):
        header = read_header(file)
        if header is None:
            others.append(file)
        else:
            groups.setdefault(header.series, []).append(header)
    slice_names = {_pattern(item.file) for slices in groups.values() for item in slices}
    for file in others:
        if _pattern(file) in slice_names and not is_dicom(file):
            raise damaged(file)
    return groups


def _pattern(file: Path) -> str:
    """Return a file's name with every number replaced by the same sign."""
    return re.sub(r"\d+", "#", file.name)


def _may_be_volume(slices: list[Slice]) -> bool:
    """Tell a stack of slices from overviews, single images and pictures of reports."""
    if any(item.frames > 1 for item in slices):
        return True
    placed = [item for item in slices if item.position is not None and LOCALIZER not in item.kind]
    return len(placed) > 1


def _named(path: Path, groups: dict[str, list[Slice]], series: str) -> list[Slice]:
    found = {
        uid: slices for uid, slices in groups.items() if series == uid or series.strip() == slices[0].number
    }
    if len(found) != 1:
        called = f"{len(found) or 'no'} series {'are' if found else 'is'} called {series}"
        raise DataError(
            f"{called}; it holds {_list(groups)}",
            where=str(path),
            expected="the number or the UID of one of them",
            mend="give the UID" if found else "give one of the numbers listed",
        )
    return next(iter(found.values()))


def _list(groups: dict[str, list[Slice]]) -> str:
    lines = [
        f"number {slices[0].number or '(none)'} {slices[0].description!r}, {len(slices)} files, UID {uid}"
        for uid, slices in groups.items()
    ]
    more = [f"and {len(lines) - _SHOWN} more"] if len(lines) > _SHOWN else []
    return "; ".join(lines[:_SHOWN] + more)


def _nothing(path: Path) -> DataError:
    inside = sorted(entry.name + "/" * entry.is_dir() for entry in path.iterdir())
    shown = ", ".join(inside[:_SHOWN]) + (", ..." if len(inside) > _SHOWN else "")
    return DataError(
        f"holds no DICOM image; there is {shown}" if inside else "is an empty folder",
        where=str(path),
        expected="the files of a DICOM series, directly in the folder",
        mend="name the folder in which the slices lie, or the .nrrd or .nii.gz file itself",
    )
