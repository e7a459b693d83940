"""Options and arguments that several commands share: each has one name and one sentence everywhere."""

import hashlib
import math
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

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


# ---- options whose values the invocation keeps: commands read them from it


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
    return Annotated[bool, typer.Option(*words, help=text, callback=_keep)]


Out = Annotated[Path | None, option("Folder to write to (default: as stated above).", "OUT", callback=_keep)]
KEPT: Mapping[str, Any] = {
    "seed": Annotated[
        int | None,
        option("Seed of random numbers (default: the recipe's).", "N", min=0, max=MAX_SEED, callback=_keep),
    ],
    "jobs": Annotated[int | None, option("Cores to use (default: all).", "N", min=1, callback=_keep)],
    "scheduler": Annotated[
        str | None,
        option(
            "Run tasks on a Dask cluster: tls://HOST:PORT (docs/developers/scale.md).",
            "ADDRESS",
            callback=_keep,
        ),
    ],
    "insecure": _flag("Accept a scheduler on another machine without encryption.", "--insecure"),
    "out": Out,
    "reference": _flag("Also write the tables to OUT/reference/STUDY/.", "--reference"),
    "resume": _flag("Continue an interrupted run.", "--resume"),
    "strict": _flag("Exit code 5 after a warning.", "--strict"),
    "explain": _flag("All tables, with notes and diagnostics.", "--explain"),
    "json": _flag("Results as JSON on stdout.", "--json"),
    "quiet": _flag("No progress on stderr.", "--quiet", "-q"),
    "plugins": Annotated[
        list[str] | None,
        option(
            "Installed Python module with further tissue laws, file formats, ... May be repeated.",
            "MODULE",
            callback=_use_plugins,
            is_eager=True,
        ),
    ],
}
"""Options of many commands, by the names of their parameters."""


def take_options(command: Callable[..., None], names: Sequence[str]) -> Callable[..., None]:
    """Return a command that also takes options of `KEPT`, behind its own."""

    @wraps(command)
    def run(**given: Any) -> None:  # noqa: ANN401 - whatever typer parses
        command(**{name: value for name, value in given.items() if name not in names})

    own = signature(command, eval_str=True)
    flags = {name: False if get_args(KEPT[name])[0] is bool else None for name in names}
    further = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=KEPT[name])
        for name, default in flags.items()
    ]
    run.__signature__ = own.replace(parameters=[*own.parameters.values(), *further])  # type: ignore[attr-defined]
    return run


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
        "Specimen of a prediction: new, same (as fitted), or of several its NAME (default: that of the "
        "insertion; of a planned one what the study states, else new).",
        "new|same|NAME",
    ),
]
Depth = Annotated[
    float | None, option("Inserted arc length of a scene without steps (default: the scene's).", "MM")
]
Changes = Annotated[
    list[str] | None,
    option(
        "Change a key of the scene: bevel.offset_mm=0.1, layers.1.mu_pa=3e5 (numbered from 1). KEY= "
        "removes the key. May be repeated.",
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
    values = {}
    for name, text in (split_pair(assignment, "--fix") for assignment in assignments):
        try:
            values[name] = float(text)
        except ValueError:
            raise typer.BadParameter(f"`{name}={text}` is not NAME=NUMBER", param_hint="--fix") from None
    return values


def name_parameters(free: Sequence[str], fix: Mapping[str, float]) -> str:
    """Return what --free and --fix change of a fit, as the end of the name of its folder."""
    words = [f"free={'+'.join(free)}"] * bool(free) + [f"{name}={value:g}" for name, value in fix.items()]
    return re.sub(r"[^A-Za-z0-9_.=+-]+", "_", "".join(f"-{word}" for word in words))


def scene_record(name: str, depth: float | None, assignments: list[str]) -> tuple[str, "SceneRecord"]:
    """Return where the scene stands and what it holds, with what the options change."""
    from needlefit.project.locate import file_label, find_file, read_toml

    path = find_file("scene", name)
    return change_scene(read_toml(path), file_label(path), depth, assignments)


def read_numbers(text: str, counts: tuple[int, int], option: str, expected: str) -> list[float]:
    """Return the numbers of an option, mm; BadParameter if there are not as many."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts or not all(
        math.isfinite(number) and abs(number) <= 1e4 for number in numbers
    ):
        raise typer.BadParameter(
            f"`{text}`; expected {expected} in mm, numbers up to 10000", param_hint=option
        )
    return numbers


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


#: largest number of characters in a folder's name that state the changes of a prediction
MAX_CHANGES_CHARACTERS = 80


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
    """Return key and value of a word of --set; an empty value removes the key."""
    key, equals, value = text.partition("=")
    if not (key.strip() and equals):
        raise typer.BadParameter(f"`{text}` is not KEY=VALUE", param_hint=words)
    return key.strip(), value.strip()
