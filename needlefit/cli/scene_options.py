"""A scene as a command takes it: its name, and what options change of it."""

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from needlefit.schemas.scene import SceneRecord


Depth = Annotated[
    float | None,
    typer.Option(metavar="MM", help="Inserted arc length, of a scene without steps; else the scene's."),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a key of the scene, e.g. bevel.offset_mm=0.1; layers, guides and steps are numbered "
        "from 1: layers.1.mu_pa=3e5 is the first one. May be given again.",
    ),
]


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


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not (key.strip() and equals and value.strip()):
        raise typer.BadParameter(f"`{text}` is not KEY=VALUE, e.g. bevel.offset_mm=0.1", param_hint="--set")
    return key.strip(), value.strip()
