"""Options that several commands share; the values of common ones are kept by the invocation."""

import inspect
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from needlefit.project.locate import STUDY_GROUPS, FileKind, list_names, list_runs
from needlefit.schemas.limits import MAX_SEED

if TYPE_CHECKING:
    from needlefit.schemas.scene import SceneRecord


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


def _flag(name: str, *words: str, text: str) -> Any:  # noqa: ANN401 - an option of typer's
    return typer.Option(*(words or (f"--{name}",)), callback=_keep(name), help=text)


Sample = Annotated[bool, _flag("sample", text="Also sample the posterior (netCDF): takes minutes.")]
Seed = Annotated[
    int | None,
    typer.Option(
        min=0, max=MAX_SEED, callback=_keep("seed"), help="Seed of all randomness (default: the recipe's)."
    ),
]
Jobs = Annotated[
    int | None,
    typer.Option(
        min=1, callback=_keep("jobs"), help="Cores to use (default: all); they do not change the result."
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        callback=_keep("scheduler"),
        help="Run tasks on a Dask cluster: tls://HOST:PORT (docs/scale.md).",
    ),
]
Insecure = Annotated[
    bool, _flag("insecure", text="Accept a scheduler on another machine without encryption.")
]
Out = Annotated[
    Path,
    typer.Option(callback=_keep("out"), help="Folder of all results; each run has a folder in it."),
]
Reference = Annotated[
    bool,
    _flag(
        "reference",
        text="Also write the tables to OUT/reference/NAME/, NAME the run's, to keep under version control.",
    ),
]
Unverified = Annotated[
    bool,
    typer.Option("--unverified", help="Also use files that do not agree with the manifest, marked as such."),
]
Resume = Annotated[bool, _flag("resume", text="Continue an interrupted run.")]
Strict = Annotated[bool, _flag("strict", text="Exit code 5 after a warning; results are written.")]
Explain = Annotated[bool, _flag("explain", text="All tables, with notes and diagnostics.")]
Json = Annotated[bool, _flag("json", text="Results as JSON on stdout.")]
Quiet = Annotated[bool, _flag("quiet", "--quiet", "-q", text="No progress on stderr.")]
Verbose = Annotated[bool, _flag("verbose", "--verbose", "-v", text="Tracebacks of errors.")]
Plugins = Annotated[
    list[str] | None,
    typer.Option(
        "--plugins",
        metavar="MODULE",
        callback=_use_plugins,
        is_eager=True,
        help="Installed Python module with further tissue laws, file formats, ...; may be repeated.",
    ),
]

_COMMON: dict[str, tuple[Any, object]] = {
    "sample": (Sample, False),
    "seed": (Seed, None),
    "jobs": (Jobs, None),
    "scheduler": (Scheduler, None),
    "insecure": (Insecure, False),
    "out": (Out, Path("reports")),
    "reference": (Reference, False),
    "resume": (Resume, False),
    "strict": (Strict, False),
    "explain": (Explain, False),
    "json": (Json, False),
    "quiet": (Quiet, False),
    "verbose": (Verbose, False),
    "plugins": (Plugins, None),
}
"""Options that many commands have, in the order of help: their types and defaults."""


def takes(names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator of commands: they also take these options, whose values the invocation keeps."""
    common = {name: _COMMON[name] for name in names.split()}
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=option)
        for name, (option, default) in common.items()
    ]

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        def run(*args: Any, **kwargs: Any) -> None:  # noqa: ANN401 - as the command has them
            command(*args, **{name: value for name, value in kwargs.items() if name not in common})

        signature = inspect.signature(command)
        parameters = [*signature.parameters.values(), *added]
        run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {**command.__annotations__, **{one.name: one.annotation for one in added}}
        return run

    return decorate


def _complete(*kinds: FileKind, runs: bool = False, more: Sequence[str] = ()) -> Callable[[str], list[str]]:
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
complete_view_targets = _complete("scene", "dataset", "scans", runs=True)


Target = Annotated[
    str,
    typer.Argument(
        metavar="TARGET",
        autocompletion=complete_targets,
        help="A study, a fit in configs/fits, or a path.",
    ),
]
RunFolder = Annotated[
    str,
    typer.Argument(
        metavar="RUN",
        autocompletion=complete_runs,
        help="A folder of results, or its bare name in reports/.",
    ),
]
Depth = Annotated[
    float | None,
    typer.Option(metavar="MM", help="Inserted arc length of a scene without steps (default: the scene's)."),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a key of the scene, e.g. bevel.offset_mm=0.1; layers, guides and steps are numbered "
        "from 1: layers.1.mu_pa=3e5 is the first layer's. KEY= removes the key. May be repeated.",
    ),
]
Markers = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Known places of the markers in the world: .csv, .fcsv, .mrk.json."),
]
Fiducials = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="The markers as placed in the scan by hand (.fcsv, .mrk.json)."),
]
Layers = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FILES...",
        help="STL, PLY, OBJ from the entry inwards; or a segmentation; auto proposes some.",
    ),
]
LayersIn = Annotated[
    Literal["world", "scan"] | None, typer.Option(help="Frame of the surfaces (default: world).")
]
Mask = Annotated[Path | None, typer.Option(metavar="FILE", help="The needle's voxels, segmented elsewhere.")]
Series = Annotated[
    str | None,
    typer.Option(metavar="NUMBER|UID", help="Which DICOM series, where a folder holds several."),
]
Medium = Annotated[str | None, typer.Option(help="Name of what was punctured (default: medium).")]


def name_scan_files(
    markers: Path | None,
    fiducials: Path | None,
    layers: list[str] | None,
    layers_in: str | None,
    mask: Path | None,
    series: str | None,
    medium: str | None,
) -> dict[str, Any]:
    """Return those options of a scan that are given, as `make_scans` takes them."""
    named = {"markers": markers, "fiducials": fiducials, "layers": layers, "surfaces_in": layers_in}
    named |= {"mask": mask, "series": series, "medium": medium}
    return {name: value for name, value in named.items() if value not in (None, [])}


def scan_option(name: str) -> str:
    """Return the option of a keyword of `make_scans`."""
    return "--layers-in" if name == "surfaces_in" else f"--{name}"


def scene_record(name: str, depth: float | None, assignments: list[str]) -> tuple[str, "SceneRecord"]:
    """Return where the scene stands and what it says, with what the options change."""
    pairs = [_pair(text) for text in assignments]
    from needlefit.project.load import check, load, read_toml
    from needlefit.project.locate import file_label, find_file
    from needlefit.project.overrides import override
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


def list_set_keys(assignments: list[str]) -> list[str]:
    """Return the keys that --set gives a value; others it removes."""
    return [key for key, value in map(_pair, assignments) if value]


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not (key.strip() and equals):
        raise typer.BadParameter(f"`{text}` is not KEY=VALUE, e.g. bevel.offset_mm=0.1", param_hint="--set")
    return key.strip(), value.strip()
