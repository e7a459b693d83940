"""Declare the options of commands: shared ones once; the values of common ones are kept by the invocation."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_origin

import typer

from needlefit.project.locate import STUDY_GROUPS, FileKind, list_names, list_runs
from needlefit.schemas.limits import MAX_SEED

if TYPE_CHECKING:
    from needlefit.schemas.scene import SceneRecord

Complete = Callable[[str], list[str]]
Declaration = Any  # what typer knows of an option or an argument, but for its type and default


def option(text: str, metavar: str | None = None, *words: str, **more: Any) -> Declaration:  # noqa: ANN401
    """Return an option with its help; `words` are its names where these are not that of its parameter."""
    return typer.Option(*words, metavar=metavar, help=text, **more)


def flag(text: str, *words: str, **more: Any) -> Declaration:  # noqa: ANN401
    """Return an option that takes no value."""
    return typer.Option(*words, help=text, **more)


def argument(metavar: str, text: str, complete: Complete | None = None, **more: Any) -> Declaration:  # noqa: ANN401
    """Return an argument with its help; `complete` returns the words that a beginning may mean."""
    return typer.Argument(metavar=metavar, help=text, autocompletion=complete, **more)


def _complete(*kinds: FileKind, runs: bool = False, more: Sequence[str] = ()) -> Complete:
    """Return what completes names of these kinds of files, of runs in reports/, and some more."""

    def complete(incomplete: str) -> list[str]:
        names = [*(name for kind in kinds for name in list_names(kind)), *more]
        names += list_runs() if runs else []
        return [name for name in names if name.startswith(incomplete)]

    return complete


complete_scenes = _complete("scene")
complete_studies = _complete("study", more=STUDY_GROUPS)
complete_targets = _complete("study", "fit")
complete_runs = _complete(runs=True)
complete_checked = _complete("dataset", "study", "fit")
complete_scans = _complete("scans")
complete_reconstructions = _complete("reconstruction")
complete_view_targets = _complete("scene", "dataset", runs=True)


def _keep(name: str) -> Callable[[typer.Context, Any], Any]:
    """Return what writes the value of an option to the field `name` of the invocation."""

    def callback(context: typer.Context, value: Any) -> Any:  # noqa: ANN401 - of the option
        setattr(context.find_root().obj, name, value)
        return value

    return callback


def _use_plugins(modules: list[str] | None) -> list[str] | None:
    if modules:
        from needlefit.registry import use_plugins

        use_plugins(modules)
    return modules


_PLUGINS_HELP = "Installed Python module with further tissue laws, file formats, ...; may be repeated."
_FLAGS = {
    "insecure": "Accept a scheduler on another machine without encryption.",
    "reference": "Also write the tables to OUT/reference/NAME/, NAME the run's, to keep under version "
    "control.",
    "resume": "Continue an interrupted run.",
    "strict": "Exit code 5 after a warning; results are written.",
    "explain": "All tables, with notes and diagnostics.",
    "json": "Results as JSON on stdout.",
    "quiet": "No progress on stderr.",
    "verbose": "Tracebacks of errors.",
}
_SHORT = {"quiet": ("-q",), "verbose": ("-v",)}
_JOBS_HELP = "Cores to use (default: all); they do not change the result."
_SCHEDULER_HELP = "Run tasks on a Dask cluster: tls://HOST:PORT (docs/developers/scale.md)."
_COMMON: dict[str, tuple[Any, object, Declaration]] = {
    **{
        name: (bool, False, flag(text, f"--{name}", *_SHORT.get(name, ()), callback=_keep(name)))
        for name, text in _FLAGS.items()
    },
    "seed": (
        int | None,
        None,
        option(
            "Seed of all randomness (default: the recipe's).", min=0, max=MAX_SEED, callback=_keep("seed")
        ),
    ),
    "jobs": (int | None, None, option(_JOBS_HELP, min=1, callback=_keep("jobs"))),
    "scheduler": (str | None, None, option(_SCHEDULER_HELP, "ADDRESS", callback=_keep("scheduler"))),
    "out": (
        Path,
        Path("reports"),
        option("Folder of all results; each run has a folder in it.", callback=_keep("out")),
    ),
    "plugins": (
        list[str] | None,
        None,
        option(_PLUGINS_HELP, "MODULE", "--plugins", callback=_use_plugins, is_eager=True),
    ),
}
"""Options whose values the invocation keeps: type, default and declaration."""

_SHARED: Mapping[str, Declaration] = {
    "target": argument("TARGET", "A study, a fit in configs/fits, or a path.", complete_targets),
    "run": argument("RUN", "A folder of results, or its bare name in reports/.", complete_runs),
    "unverified": flag("Also use files that do not agree with the manifest, marked as such.", "--unverified"),
    "depth": option("Inserted arc length of a scene without steps (default: the scene's).", "MM"),
    "set_": option(
        "Change a key of the scene, e.g. bevel.offset_mm=0.1; layers, guides and steps are numbered from 1: "
        "layers.1.mu_pa=3e5 is the first layer's. KEY= removes the key. May be repeated.",
        "KEY=VALUE",
        "--set",
    ),
}
"""Parameters that several commands have in their signatures."""


SCAN_FILES: Mapping[str, Any] = {
    "markers": Annotated[
        Path | None, option("Known places of the markers in the world: .csv, .fcsv, .mrk.json.", "FILE")
    ],
    "fiducials": Annotated[
        Path | None, option("The markers as placed in the scan by hand (.fcsv, .mrk.json).", "FILE")
    ],
    "layers": Annotated[
        list[str] | None,
        option("STL, PLY, OBJ from the entry inwards; or a segmentation.", "FILES..."),
    ],
    "layers_in": Annotated[
        Literal["world", "scan"] | None, option("Frame of the surfaces (default: world).")
    ],
    "mask": Annotated[Path | None, option("The needle's voxels, segmented elsewhere.", "FILE")],
    "series": option("Which DICOM series, where a folder holds several.", "NUMBER|UID"),
    "medium": option("Name of what was punctured (default: medium)."),
}
"""Files of a scan, which `reconstruct` takes as `**files`."""


def takes(common: str, **own: Declaration) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator of commands that declares what they take.

    Parameters
    ----------
    common : str
        Names of options that they take besides, whose values the invocation keeps; all take --plugins.
    own : by parameter
        Declarations of parameters that are not shared. Types and defaults are those of the signature; what is
        not in it is optional, a text unless it states another type, and given to the `**` of the command.
    """
    kept = {name: _COMMON[name] for name in (*common.split(), "plugins")}

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        def run(*args: Any, **kwargs: Any) -> None:  # noqa: ANN401 - as the command has them
            command(*args, **{name: value for name, value in kwargs.items() if name not in kept})

        stated, before = dict(inspect.signature(command).parameters), ""
        order = [name for name, one in stated.items() if one.kind is not inspect.Parameter.VAR_KEYWORD]
        for name in own:
            if name not in order:
                order.insert(order.index(before) + 1, name)
            before = name
        taken: dict[str, tuple[Any, object]] = {}
        for name in order:
            declared, one = own.get(name, _SHARED.get(name)), stated.get(name)
            if one is None:
                is_typed = get_origin(declared) is Annotated
                taken[name] = (declared if is_typed else Annotated[str | None, declared]), None
            else:
                kind = one.annotation if declared is None else Annotated[one.annotation, declared]
                taken[name] = kind, one.default
        taken |= {
            name: (Annotated[kind, declared], default) for name, (kind, default, declared) in kept.items()
        }
        parameters = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
            for name, (kind, default) in taken.items()
        ]
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {name: kind for name, (kind, _) in taken.items()}
        return run

    return decorate


def name_scan_files(files: Mapping[str, Any]) -> dict[str, Any]:
    """Return the files of a scan that are given, as `make_scans` takes them."""
    given = {name: value for name, value in files.items() if value not in (None, [])}
    return {"surfaces_in" if name == "layers_in" else name: value for name, value in given.items()}


def scan_option(name: str) -> str:
    """Return the option of a keyword of `make_scans`."""
    return "--layers-in" if name == "surfaces_in" else f"--{name}"


def scene_record(name: str, depth: float | None, assignments: list[str]) -> tuple[str, "SceneRecord"]:
    """Return where the scene stands and what it says, with what the options change."""
    pairs = [split_pair(text) for text in assignments]
    from needlefit.project.locate import file_label, find_file
    from needlefit.project.toml import check, load, override, read_toml
    from needlefit.schemas.scene import SceneRecord

    path = find_file("scene", name)
    record = load(path, SceneRecord)
    if depth is not None:
        if record.steps:
            raise typer.BadParameter(
                "the scene has steps, each with its own depth: "
                f"--set steps.{len(record.steps)}.depth_mm={depth:g}",
                param_hint="--depth",
            )
        pairs.append(("depth_mm", repr(depth)))
    if not pairs:
        return file_label(path), record
    where = f"{file_label(path)}, changed by {', '.join(f'{key}={value}' for key, value in pairs)}"
    return where, check(override(read_toml(path), pairs, SceneRecord, file_label(path)), SceneRecord, where)


def split_pair(text: str) -> tuple[str, str]:
    """Return key and value of a word of --set; an empty value removes the key."""
    key, equals, value = text.partition("=")
    if not (key.strip() and equals):
        raise typer.BadParameter(f"`{text}` is not KEY=VALUE, e.g. bevel.offset_mm=0.1", param_hint="--set")
    return key.strip(), value.strip()
