"""Find the files of a dataset, and verify their checksums."""

import hashlib
import os
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from needlefit.datasets.faults import Fault, note_fault
from needlefit.errors import DataError
from needlefit.project.folders import list_all_files, sha256
from needlefit.project.input_files import is_dir, is_file
from needlefit.schemas.dataset import SourceRecord


def find_dataset_file(path: Path) -> Path:
    """Return the `dataset.toml` of `path`, which is a dataset's folder or that file."""
    return path / DATASET_FILE if is_dir(path) else path


def find_folder(record: SourceRecord, path: Path) -> Path:
    """Return the folder with the files: that of `path`, or the one that matches `root`.

    DataError if `root` names an environment variable that is not set, or does not match one folder.
    """
    if record.root is None:
        return path.parent
    if "$" in os.path.expandvars(record.root):
        raise DataError(
            f"root is {record.root}, and that environment variable is not set",
            expected="the folder of the dataset folders",
            fix=record.how_to_get or "set it and run again",
            where=path,
        )
    absolute, folder = _match_folders(record.root, path)
    if len(folder) != 1:
        fix = "narrow root" if folder else record.how_to_get or "check the path"
        raise DataError(
            f"{len(folder) or 'no'} folder{'s match' if folder else ' matches'} root {record.root}",
            expected=f"one: {absolute}",
            fix=fix,
            where=path,
        )
    return folder[0]


def _match_folders(root: str, path: Path) -> tuple[Path, tuple[Path, ...]]:
    """Return the pattern that a root means, and the folders that match it, sorted."""
    expanded = os.path.expandvars(root)
    absolute = Path(expanded) if Path(expanded).is_absolute() else path.parent / expanded
    anchor = Path(absolute.anchor or ".")
    pattern = str(absolute.relative_to(anchor)) if absolute.anchor else str(absolute)
    return absolute, tuple(sorted(folder for folder in anchor.glob(pattern) if is_dir(folder)))


def find_checksum_faults(checksums: Mapping[str, str], folder: Path) -> list[Fault]:
    """Return the files of `folder` whose checksums differ from the listed ones."""
    faults = list[Fault]()
    for name, expected in checksums.items():
        file = folder / name
        problem, fix = "there is no such file, but [checksums] lists it", "remove its line under [checksums]"
        if is_file(file):
            if (actual := sha256(file)) == expected.lower():
                continue
            problem = "is not the file described: wrong checksum"
            fix = f"if the change is meant, write {actual} under [checksums]"
        note_fault(faults, file, problem, f"sha256 {expected}", f"restore the file, or {fix}")
    return faults


def compute_digest(path: Path, root: Path, files: Iterable[Path]) -> str:
    """Return the SHA-256 over names and contents of the dataset file and `files`, in the order of names.

    Names are relative to the folder of the data, `root`, so that a copy elsewhere has the same digest.
    """
    named = {DATASET_FILE: path} | {str(file.relative_to(root)): file for file in files}
    total = hashlib.sha256()
    for name, file in sorted(named.items()):
        total.update(f"{name}\0{sha256(file)}\n".encode())
    return total.hexdigest()


DATASET_FILE = "dataset.toml"


@dataclass(frozen=True)
class DatasetFiles:
    """The files that a dataset was read from: its `dataset.toml`, and the others, by name, below `root`.

    Both are absolute: they are found from any working folder.
    """

    file: Path
    root: Path
    names: tuple[str, ...]

    @classmethod
    def of_copy(cls, folder: Path) -> "DatasetFiles":
        """Return the files of a copy that `copy_to` made."""
        names = tuple(name for name in list_all_files(folder) if name != DATASET_FILE)
        return cls(folder.absolute() / DATASET_FILE, folder.absolute(), names)

    @property
    def can_be_copied(self) -> bool:
        """Whether every file lies below `root`, as its name states."""
        return not any(".." in Path(name).parts for name in self.names)

    @property
    def size(self) -> int:
        """Bytes of all files; OSError if one is missing."""
        return sum(path.stat().st_size for path in (self.file, *self._others()))

    def digest(self) -> str:
        """Return the digest of the files as they are now; OSError if one is missing."""
        return compute_digest(self.file, self.root, self._others())

    def copy_to(self, folder: Path) -> None:
        """Copy all files to a folder, under their names; OSError if one is missing."""
        folder.mkdir(exist_ok=True)
        shutil.copyfile(self.file, folder / DATASET_FILE)
        for name in self.names:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(self.root / name, folder / name)

    def differ_from(self, file: Path) -> bool:
        """Return whether another `dataset.toml`, or a file beside it, differs from that of the same name."""
        pairs = [(self.file, file), *((self.root / name, file.parent / name) for name in self.names)]
        return any(is_file(other) and sha256(other) != sha256(file) for file, other in pairs)

    def _others(self) -> list[Path]:
        return [self.root / name for name in self.names]
