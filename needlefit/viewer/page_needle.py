"""The page of a needle: one HTML file that computes it, and its content as values for JSON; mm, frame C."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.simulate import find_last_shape
from needlefit.mechanics.tissue import Tissue
from needlefit.planning.steered_needle import (
    RecordedStep,
    Recording,
    SteeredNeedle,
    format_head,
    list_scene_changes,
    make_steered_scene,
)
from needlefit.reporting import needle_page
from needlefit.viewer.measured import ViewedScene

if TYPE_CHECKING:
    from needlefit.planning.steering import SteeringPlan

LENGTH_DIGITS = 4  #: number of decimals of drawn lengths in mm
PLAN_NEEDLES = 40  #: number of needles, of the draws of a plan, that are drawn


def compose_page(
    viewed_scene: ViewedScene, recording: Recording | None = None, plan: "SteeringPlan | None" = None
) -> str:
    """Return the text of an HTML file on which a needle is steered, from the end of `recording` if given.

    ConfigError if the model does not take the scene, or this installation has no kernel in WebAssembly.
    """
    head = viewed_scene.make_head() if recording is None else recording.head
    scene = make_steered_scene(head.scene, viewed_scene.name)
    steering, steps = SteeredNeedle(scene, head.first_cell_mm), recording.steps if recording else ()
    encoded = encode_scene(viewed_scene, steering) | {"plan": plan and encode_plan(plan)}
    encoded["simulation"]["law"]["tables"] = encode_tables(steering.scene.tissue, steps)
    needle = {
        "scene": encoded, "new_specimen": viewed_scene.specimen == "new", "head": format_head(head),
    }  # fmt: skip
    if recording is None:
        shape = find_last_shape(scene.needle, scene.tissue, scene.steps, scene.rules)
        needle["tip"] = shape.tip_lateral if shape.converged else None
    else:
        needle["recording"] = [
            [
                step.time,
                [[change.name, change.item, change.value] for change in step.changes],
                step.tip_lateral,
            ]
            for step in steps
        ]
    data = needle_page.PageData({"needlefit": head.needlefit})
    data.needles.append(needle)
    return needle_page.compose_file(viewed_scene.title, viewed_scene.note, data)


def encode_plan(plan: "SteeringPlan") -> dict[str, Any]:
    """Return target, obstacles and needles of a plan in its plane, as the page draws them."""
    solved = plan.needles[plan.solved]
    drawn = solved[needle_page.choose_evenly(len(solved), PLAN_NEEDLES)]
    return {
        "target": list(plan.goal.target[:2]),
        "radius": plan.goal.radius,
        "obstacles": [
            [*obstacle.centre_mm[:2], obstacle.radius_mm, obstacle.name] for obstacle in plan.goal.obstacles
        ],
        "needles": drawn[..., :2].swapaxes(1, 2).round(LENGTH_DIGITS).tolist(),
    }


def encode_scene(viewed_scene: ViewedScene, steering: SteeredNeedle) -> dict[str, Any]:
    """Return all that stays constant: the needle, the layers, the measured needle, the draws."""
    scene, names, spread = steering.scene, steering.names, viewed_scene.spread
    changes = list_scene_changes(scene.steps, names)
    mark = viewed_scene.origin_mark
    return needle_page.encode_scene(scene, steering.first_cell, names, changes, viewed_scene.title, mark) | {
        "measured": viewed_scene.measured,
        "draws": spread and needle_page.encode_draws(spread, scene.tissue.law),
    }


def encode_tables(tissue: Tissue, steps: Sequence[RecordedStep]) -> list[Any]:
    """Return shape parameters and law for all that occur in steps; none where the page computes the law."""
    names = LAWS[tissue.law].shape_names
    if needle_page.encode_terms(tissue) is not None:
        return []
    after, tables = {0: tissue.shape}, dict[str, Any]()
    for number, step in enumerate(steps, start=1):
        first, shape = step.changes[0], after[number - 1]
        if first.name == "return_to":
            shape = after.get(int(first.value), shape)
        for change in step.changes:
            if change.name in names and change.item is not None and change.item <= tissue.layers:
                shape = shape.copy()
                shape[names.index(change.name), change.item - 1] = change.value
        after[number] = shape
        if shape is not tissue.shape:
            law = needle_page.encode_law(tissue.law, shape).ravel().tolist()
            tables.setdefault(str(shape.tolist()), [shape.tolist(), law])
    return list(tables.values())
