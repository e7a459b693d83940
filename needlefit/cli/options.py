"""Options and arguments that several commands share: each has one name and one sentence everywhere."""

import hashlib
import inspect
import re
import shlex
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints

import typer

from needlefit.cli import screen
from needlefit.schemas.limits import MAX_SEED

if TYPE_CHECKING:
    from needlefit.schemas.scene import SceneRecord


def option(text: str, metavar: str | None = None, *words: str, **more: Any) -> Any:  # noqa: ANN401 - typer's
    """Return an option with its help; `words` are its names where these are not that of its parameter."""
    return typer.Option(*words, metavar=metavar, help=text, **more)


def argument(metavar: str, text: str, **more: Any) -> Any:  # noqa: ANN401 - typer's
    """Return an argument with its help."""
    return typer.Argument(metavar=metavar, help=text, **more)


def fill_records(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command whose options fill the records among the parameters of a function: one for each field.

    Such a parameter is `Annotated[Record, {field: option}]`, or a dataclass whose fields are annotated so.
    """
    parameters, records = list[inspect.Parameter](), dict[str, Any]()
    hints = get_type_hints(command, include_extras=True)
    for name, parameter in inspect.signature(command).parameters.items():
        kind, *more = get_args(hints[name]) or (hints[name],)
        if not is_dataclass(kind):
            parameters.append(parameter.replace(annotation=hints[name], kind=parameter.KEYWORD_ONLY))
            continue
        records[name], own = kind, get_type_hints(kind, include_extras=True)
        for one in fields(kind):
            annotation = _repeat(own[one.name])
            annotation = Annotated[annotation, more[0][one.name]] if more else annotation
            default = list(one.default) or None if isinstance(one.default, tuple) else one.default
            parameters.append(
                inspect.Parameter(one.name, parameter.KEYWORD_ONLY, default=default, annotation=annotation)
            )

    @wraps(command)
    def fill(**given: Any) -> None:  # noqa: ANN401 - of any command
        for name, kind in records.items():
            values = {one.name: given.pop(one.name) for one in fields(kind)}
            lists = {key: tuple(value) for key, value in values.items() if isinstance(value, list)}
            given[name] = kind(**{key: one for key, one in (values | lists).items() if one is not None})
        command(**given)

    fill.__annotations__ = {one.name: one.annotation for one in parameters}
    fill.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return fill


def _repeat(annotation: Any) -> Any:  # noqa: ANN401 - of any field
    """Return the annotation of an option for that of a field: one that may be repeated for a tuple."""
    kind, *more = get_args(annotation) if get_origin(annotation) is Annotated else (annotation,)
    if get_origin(kind) is tuple:
        kind = types.GenericAlias(list, get_args(kind)[:1])
    return Annotated.__class_getitem__((kind, *more)) if more else kind  # type: ignore[attr-defined]


# ---- options whose values the invocation keeps


def _keep(context: typer.Context, parameter: typer.CallbackParam, value: Any) -> Any:  # noqa: ANN401
    if value is not None:  # else the invocation's own default
        setattr(context.find_root().obj, str(parameter.name), value)
    return value


def _use_plugins(modules: list[str] | None) -> list[str] | None:
    if modules:
        from needlefit.plugins import use_plugins

        use_plugins(modules)
    return modules


def _flag(text: str, *words: str) -> Any:  # noqa: ANN401 - typer's
    return typer.Option(*words, help=text, callback=_keep)


Explain = Annotated[bool, _flag("All tables, with notes and diagnostics.", "--explain")]
Insecure = Annotated[bool, _flag("Accept a scheduler on another machine without encryption.", "--insecure")]
Json = Annotated[bool, _flag("Results as JSON on stdout.", "--json")]
Quiet = Annotated[bool, _flag("No progress on stderr.", "--quiet", "-q")]
Reference = Annotated[
    bool,
    _flag(
        "Also write the tables to OUT/reference/STUDY/, to keep under version control.",
        "--reference",
    ),
]
Resume = Annotated[bool, _flag("Continue an interrupted run.", "--resume")]
Strict = Annotated[bool, _flag("Exit code 5 after a warning; results are written.", "--strict")]
Seed = Annotated[
    int | None,
    option(
        "Seed of all randomness (default: that of the recipe, or of the shipped twin).",
        "N",
        min=0,
        max=MAX_SEED,
        callback=_keep,
    ),
]
Jobs = Annotated[
    int | None,
    option("Cores to use (default: all); they do not change the result.", "N", min=1, callback=_keep),
]
Scheduler = Annotated[
    str | None,
    option(
        "Run tasks on a Dask cluster: tls://HOST:PORT (docs/developers/scale.md).", "ADDRESS", callback=_keep
    ),
]
Out = Annotated[Path | None, option("Folder to write to (default: as stated above).", "OUT", callback=_keep)]
Plugins = Annotated[
    list[str] | None,
    option(
        "Installed Python module with further tissue laws, file formats, ... May be repeated.",
        "MODULE",
        callback=_use_plugins,
        is_eager=True,
    ),
]


@dataclass(frozen=True)
class RunOptions:
    """How a long command runs, and what it prints."""

    jobs: Jobs = None
    scheduler: Scheduler = None
    insecure: Insecure = False
    resume: Resume = False
    strict: Strict = False
    json: Json = False
    quiet: Quiet = False
    plugins: Plugins = None


@dataclass(frozen=True)
class FitOptions:
    """How a fit, or a prediction with one, runs on this machine, and what it prints."""

    seed: Seed = None
    jobs: Jobs = None
    out: Out = None
    resume: Resume = False
    strict: Strict = False
    explain: Explain = False
    json: Json = False
    quiet: Quiet = False
    plugins: Plugins = None


@dataclass(frozen=True)
class StudyOptions(FitOptions):
    """How studies run, and what they print and write."""

    reference: Reference = False


@dataclass(frozen=True)
class CheckOptions:
    """What a command that makes or checks data prints, and when it fails."""

    strict: Strict = False
    json: Json = False
    plugins: Plugins = None


# ---- other parameters of several commands

Target = Annotated[str, argument("TARGET", "A study, a fit in configs/fits, a path, or the folder of a run.")]
RunName = Annotated[
    str,
    argument("RUN", "A folder of results, or its bare name in reports/."),
]
Recording = Annotated[
    Path | None, option("Replay what `needlefit view` recorded, a CSV; it replaces SCENE.", "LOG")
]
Specimen = Annotated[
    str | None,
    option(
        "Specimen of a prediction: new; same: as fitted; or, of several that differ, its NAME (default: "
        "that of the insertion; of a planned one what the study states, else new).",
        "new|same|NAME",
    ),
]
Depth = Annotated[
    float | None, option("Inserted arc length of a scene without steps (default: the scene's).", "MM")
]
Changes = Annotated[
    list[str] | None,
    option(
        "Change a key of the scene, e.g. bevel.offset_mm=0.1; layers, guides and steps are numbered from 1: "
        "layers.1.mu_pa=3e5 is the first layer's. KEY= removes the key. May be repeated.",
        "KEY=VALUE",
        "--set",
    ),
]
Free = Annotated[
    list[str] | None,
    option(
        "Search a parameter that is fixed, tied or known by its prior: alpha1; alpha: of every layer. May be "
        "repeated.",
        "NAME",
    ),
]
Fix = Annotated[
    list[str] | None,
    option("Hold a parameter, in Pa, mm or degrees: alpha1=1, b=0.05. May be repeated.", "NAME=VALUE"),
]


def split_values(assignments: Sequence[str]) -> dict[str, float]:
    """Return the values of words of --fix by the name of their parameter."""
    found = {}
    for name, text in (split_pair(one, "--fix") for one in assignments):
        try:
            found[name] = float(text)
        except ValueError:
            raise typer.BadParameter(f"`{name}={text}` is not NAME=NUMBER", param_hint="--fix") from None
    return found


def name_parameters(free: Sequence[str], fix: Mapping[str, float]) -> str:
    """Return what --free and --fix change of a fit, as the end of the name of its folder."""
    words = [f"free={'+'.join(free)}"] * bool(free) + [f"{name}={value:g}" for name, value in fix.items()]
    return re.sub(r"[^A-Za-z0-9_.=+-]+", "_", "".join(f"-{word}" for word in words))


def scene_record(name: str, depth: float | None, assignments: list[str]) -> tuple[str, "SceneRecord"]:
    """Return where the scene stands and what it holds, with what the options change."""
    from needlefit.project.locate import file_label, find_file, read_toml

    path = find_file("scene", name)
    return change_scene(read_toml(path), file_label(path), depth, assignments)


def note_others(command: str, name: str) -> None:
    """Print how a command opens the scene or dataset that has the name of a run, too."""
    from needlefit.project.locate import find_view_target

    target = find_view_target(name)
    for kind, path in target.others:
        command_line = shlex.join(("needlefit", command, str(path)))
        screen.print_note(f"`{name}` is the {target.kind}; the {kind}: {command_line}")


def change_scene(
    scene: dict[str, Any], label: str, depth: float | None, assignments: list[str]
) -> tuple[str, "SceneRecord"]:
    """Return the keys of a scene, checked, with what the options change, and what messages call it."""
    pairs = [split_pair(text) for text in assignments]
    from needlefit.project.toml import check, override
    from needlefit.schemas.scene import SceneRecord

    record = check(scene, SceneRecord, label)
    if depth is not None:
        if record.steps:
            raise typer.BadParameter(
                "the scene has steps, each with its own depth: "
                f"--set steps.{len(record.steps)}.depth_mm={depth:g}",
                param_hint="--depth",
            )
        pairs.append(("depth_mm", repr(depth)))
    if not pairs:
        return label, record
    where = f"{label}, changed by {', '.join(f'{key}={value}' for key, value in pairs)}"
    return where, check(override(scene, pairs, label), SceneRecord, where)


MAX_CHANGES_CHARACTERS = 80  #: of the name of a folder


def name_changes(depth: float | None, assignments: Sequence[str], specimen: str | None) -> str:
    """Return what these options change of a prediction, as the end of the name of its folder.

    It does not depend on their order. Where characters cannot stand in a name, or are too many, a digest of
    all of them follows.
    """
    changes = dict(map(split_pair, assignments))
    if depth is not None:
        changes["depth_mm"] = repr(depth).removesuffix(".0")
    if specimen is not None:
        changes["specimen"] = specimen
    words = "".join(f"-{key}={changes[key]}" for key in sorted(changes))
    plain = re.sub(r"[^A-Za-z0-9_.=+-]+", "_", words)[:MAX_CHANGES_CHARACTERS]
    return plain if plain == words else f"{plain}-{hashlib.sha256(words.encode()).hexdigest()[:8]}"


def split_pair(text: str, words: str = "--set") -> tuple[str, str]:
    """Return key and value of a word of --set or --setup; an empty value removes the key."""
    key, equals, value = text.partition("=")
    if not (key.strip() and equals):
        raise typer.BadParameter(f"`{text}` is not KEY=VALUE", param_hint=words)
    return key.strip(), value.strip()
