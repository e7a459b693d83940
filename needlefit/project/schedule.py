"""The steps of a scene, each one whole: what a step leaves unsaid carries over from the one before."""

from dataclasses import dataclass
from typing import Any

from needlefit.project.records.scene import BevelRecord, ControlsRecord, SceneRecord
from needlefit.project.records.steps import GuideRecord, StepRecord


@dataclass(frozen=True)
class WholeStep:
    """One step with all of its inputs.

    Attributes
    ----------
    depth_mm : float
    bevel : BevelRecord
    controls : ControlsRecord
    guides : tuple of (str, GuideRecord)
        Each with the key of the file that put it where it is.
    key : str
        The key of the file that says the depth.
    """

    depth_mm: float
    bevel: BevelRecord
    controls: ControlsRecord
    guides: tuple[tuple[str, GuideRecord], ...]
    key: str


def schedule(scene: SceneRecord) -> tuple[WholeStep, ...]:
    """Return the scene's steps, at least one; a scene that has none is one step to its `depth_mm`."""
    guides = {guide.name: (f"guides.{n}", guide) for n, guide in enumerate(scene.guides, start=1)}
    if scene.depth_mm is not None:
        return (WholeStep(scene.depth_mm, scene.bevel, scene.controls, tuple(guides.values()), "depth_mm"),)
    whole = []
    bevel, controls = scene.bevel, scene.controls
    for n, step in enumerate(scene.steps, start=1):
        bevel = bevel.model_copy(update=_said(step, "offset_mm", "side"))
        controls = controls.model_copy(update=_said(step, "base_y_mm", "base_slope_deg") | _tip(step))
        for name, move in step.guides.items():
            moved = guides[name][1].model_copy(update=move.model_dump(exclude_none=True))
            guides[name] = (f"steps.{n}.guides.{name}", moved)
        key = f"steps.{n}.depth_mm"
        whole.append(WholeStep(step.depth_mm, bevel, controls, tuple(guides.values()), key))
    return tuple(whole)


def _said(step: StepRecord, *names: str) -> dict[str, Any]:
    """Return those of the named keys that the step gives."""
    return {name: getattr(step, name) for name in names if getattr(step, name) is not None}


def _tip(step: StepRecord) -> dict[str, float | None]:
    """Return what the step says of the tip: a new place, or that it is free."""
    if step.tip_y_mm is None and not step.tip_free:
        return {}
    return {"tip_y_mm": step.tip_y_mm, "tip_slope_deg": step.tip_slope_deg}
