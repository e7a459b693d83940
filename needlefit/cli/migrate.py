"""`needlefit migrate`: files of earlier versions, rewritten with the names of today."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import options, screen


def migrate(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="PATH",
            help="TOML files, recordings of `view`, runs, or folders that hold any of them.",
        ),
    ],
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only list the files that would be rewritten.")
    ] = False,
    verbose: options.Verbose = False,
) -> None:
    """Rewrite files of earlier versions with the present names of keys, columns and files.

    Numbers, comments and layout stay. A run is written anew from its stored results; nothing is computed
    again. Files that are up to date are not touched.
    """
    from needlefit.errors import ConfigError, NeedlefitError
    from needlefit.project.input_files import path_exists

    missing = [path for path in paths if not path_exists(path)]
    if missing:
        raise ConfigError("there is no such file or folder", where=str(missing[0]), fix="check the path")
    found = [item for path in paths for item in _find(path)]
    faults: dict[Path, NeedlefitError] = {}
    changed = 0
    for path in found:
        try:
            changed += _migrate(path, dry_run)
        except NeedlefitError as fault:
            if path in paths:
                raise
            faults[path] = fault
    verb = "to rewrite" if dry_run else "rewritten"
    screen.print_line(f"{changed} {verb}, {len(found) - changed - len(faults)} up to date")
    for path, skipped in faults.items():
        screen.print_note(f"skipped {path}, which {skipped.what[:200]}; {skipped.fix}".removesuffix("; "))


def _find(path: Path) -> Iterator[Path]:
    """Yield the files and runs at a path: combined reports last, since they need their parts."""
    from needlefit.project.input_files import is_dir

    if not is_dir(path):
        yield path
        return
    runs = sorted(file.parent for file in path.rglob("run.json") if not _is_hidden(file, path))
    yield from sorted(runs, key=lambda run: not (run / "results.json.gz").exists())
    for pattern in ("*.toml", "*.csv"):
        for file in sorted(path.rglob(pattern)):
            within_run = any(file.is_relative_to(run) for run in runs)
            if not within_run and not _is_hidden(file, path) and _is_candidate(file):
                yield file


def _is_hidden(file: Path, root: Path) -> bool:
    return any(part.startswith(".") or part.endswith(".partial") for part in file.relative_to(root).parts)


def _is_candidate(file: Path) -> bool:
    """Whether a file is a TOML file with a `schema`, or a recording."""
    from needlefit.errors import NeedlefitError
    from needlefit.project.input_files import read_text

    try:
        text = read_text(file)
    except NeedlefitError:
        return False
    marker = "schema" if file.suffix == ".toml" else "# schema"
    return any(line.startswith(marker) for line in text.splitlines())


def _migrate(path: Path, dry_run: bool) -> bool:
    """Rewrite one file or run, and print its name; return whether there was anything to rewrite."""
    from needlefit.project.input_files import is_dir
    from needlefit.studies.migration import migrate_file
    from needlefit.studies.run_migration import migrate_run

    changed = migrate_run(path, dry_run) if is_dir(path) else migrate_file(path, dry_run)
    if changed:
        screen.print_line(str(path))
    return changed
