"""Which folders building a twin may replace: its own output, and nothing that anybody added to it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from needlefit.errors import ConfigError
from needlefit.project.load import read_toml
from needlefit.project.replace import replacing

TWIN_EXPECTED = "no such folder, an empty one, or one that `needlefit twin build` wrote and nobody added to"


@contextmanager
def replacing_twin(folder: Path) -> Iterator[Path]:
    """Yield what `replacing` does, for a folder that holds nothing or an earlier twin.

    Raises
    ------
    ConfigError
        If `folder` holds anything that building a twin does not write: no user's file is ever deleted.
    """
    _require_twin(folder)
    with replacing(folder) as fresh:
        yield fresh
        _require_twin(folder)  # building takes a while: somebody may have put a file there


def _require_twin(folder: Path) -> None:
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    why = _no_twin(folder)
    if why:
        raise ConfigError(
            f"is not replaced: {why}",
            where=str(folder),
            expected=TWIN_EXPECTED,
            mend="choose another folder with --out, or move yours away",
        )


def _no_twin(folder: Path) -> str:
    """Return why a folder is not, or not only, the output of building a twin; empty if it is."""
    if not folder.is_dir():
        return "it is a file"
    try:
        tables = read_toml(folder / "dataset.toml")
    except ConfigError:
        return "it holds no dataset.toml that can be read"
    if tables.get("name") != "twin" or tables.get("origin") != "synthetic":
        return "its dataset.toml is not a twin's"
    if not (folder / "truth.toml").is_file():
        return "it holds no truth.toml"
    written = {"dataset.toml", "truth.toml", *tables.get("checksums", {})}
    held = (path for path in sorted(folder.rglob("*")) if path.is_symlink() or not path.is_dir())
    foreign = [name for path in held if (name := path.relative_to(folder).as_posix()) not in written]
    return f"it holds {foreign[0]}, which a twin does not" if foreign else ""
