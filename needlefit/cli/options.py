"""Options that several commands share."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from needlefit.project.locate import STUDY_GROUPS, list_names, list_runs
from needlefit.schemas.limits import MAX_SEED

if TYPE_CHECKING:
    from needlefit.schemas.scene import SceneRecord


def _set_quiet(context: typer.Context, value: bool) -> bool:
    context.find_root().obj.quiet = value
    return value


def _set_verbose(context: typer.Context, value: bool) -> bool:
    context.find_root().obj.verbose = value
    return value


def _set_strict(context: typer.Context, value: bool) -> bool:
    context.find_root().obj.strict = value
    return value


def _set_explain(context: typer.Context, value: bool) -> bool:
    context.find_root().obj.explain = value
    return value


def _use_plugins(modules: list[str] | None) -> list[str] | None:
    if modules:
        from needlefit.registry import use_plugins

        use_plugins(modules)
    return modules


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
Quiet = Annotated[bool, typer.Option("--quiet", "-q", callback=_set_quiet, help="No progress on stderr.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", callback=_set_verbose, help="Tracebacks of errors.")
]
Json = Annotated[bool, typer.Option("--json", help="Results as JSON on stdout.")]
Seed = Annotated[
    int | None, typer.Option(min=0, max=MAX_SEED, help="Seed of all randomness (default: the recipe's).")
]
Jobs = Annotated[
    int | None, typer.Option(min=1, help="Cores to use (default: all); they do not change the result.")
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Run tasks on a Dask cluster: tls://HOST:PORT (docs/scale.md).",
    ),
]
Insecure = Annotated[
    bool, typer.Option("--insecure", help="Accept a scheduler on another machine without encryption.")
]
Out = Annotated[Path, typer.Option(help="Folder of all results; each run has a folder in it.")]
Sample = Annotated[bool, typer.Option("--sample", help="Also sample the posterior (netCDF): takes minutes.")]
Resume = Annotated[bool, typer.Option("--resume", help="Continue an interrupted run.")]
Reference = Annotated[
    bool,
    typer.Option(
        "--reference",
        help="Also write the tables to OUT/reference/NAME/, NAME the run's, to keep under version control.",
    ),
]

Strict = Annotated[
    bool,
    typer.Option("--strict", callback=_set_strict, help="Exit code 5 after a warning; results are written."),
]

Explain = Annotated[
    bool,
    typer.Option("--explain", callback=_set_explain, help="All tables, with notes and diagnostics."),
]


def complete_scenes(incomplete: str) -> list[str]:
    """Return the scenes whose names begin so."""
    return _with_prefix(list_names("scene"), incomplete)


def complete_studies(incomplete: str) -> list[str]:
    """Return the studies whose names begin so, and the names of several."""
    return _with_prefix([*list_names("study"), *STUDY_GROUPS], incomplete)


def complete_targets(incomplete: str) -> list[str]:
    """Return the studies and fits whose names begin so."""
    return _with_prefix([*list_names("study"), *list_names("fit")], incomplete)


def complete_runs(incomplete: str) -> list[str]:
    """Return the runs in reports/ whose names begin so."""
    return [name for name in list_runs() if name.startswith(incomplete)]


def complete_checked(incomplete: str) -> list[str]:
    """Return the datasets, studies and fits whose names begin so."""
    return _with_prefix(list_names("dataset"), incomplete) + complete_targets(incomplete)


def complete_scans(incomplete: str) -> list[str]:
    """Return the tables of scans whose names begin so."""
    return _with_prefix(list_names("scans"), incomplete)


def complete_reconstructions(incomplete: str) -> list[str]:
    """Return the recipes of reconstruction whose names begin so."""
    return _with_prefix(list_names("reconstruction"), incomplete)


def complete_view_targets(incomplete: str) -> list[str]:
    """Return the scenes, runs, datasets and tables of scans whose names begin so."""
    names = [name for kind in ("scene", "dataset", "scans") for name in list_names(kind)]
    return _with_prefix([*names, *list_runs()], incomplete)


def _with_prefix(known: list[str], incomplete: str) -> list[str]:
    return [name for name in known if name.startswith(incomplete)]


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
