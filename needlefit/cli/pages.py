"""Commands that write a page of a needle: view, to steer it by hand; plan, how to steer it to a target.

A plan states the probability that the target is reached, past obstacles.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Annotated, Any

import typer

from needlefit.cli import exit_codes, options, screen
from needlefit.cli.execution import require_no_faults
from needlefit.cli.options import argument, option, read_numbers
from needlefit.project.folders import require_output_files, require_writable

if TYPE_CHECKING:
    from needlefit.planning.goals import Goal, PlaneGoal
    from needlefit.planning.steering import SteeringPlan
    from needlefit.studies.first_page import RunFault
    from needlefit.viewer.measured import ViewedScene


def view(
    context: typer.Context,
    target: Annotated[
        str | None,
        argument(
            "SCENE | RUN[/ID] | DATASET/ID",
            "What to steer: a scene, a run's fitted insertion, or a measured one.",
        ),
    ] = None,
    recording: options.Recording = None,
    specimen: options.Specimen = None,
    browser: Annotated[
        bool, option("Open the page, or only print its path.", None, "--browser/--no-browser")
    ] = True,
) -> None:
    """Write a page on which a needle is steered by hand, and open it.

    The page is one HTML file, OUT/view/NAME.html (default: ./reports): it computes the needle in any browser,
    offline. It saves the inputs as a recording, which `needlefit simulate --recording FILE` replays.
    """
    if recording is not None and target is not None:
        raise typer.BadParameter("the recording names its target: leave it out", param_hint="TARGET")
    folder = context.find_root().obj.out / "view"
    require_writable(folder)
    if target is not None:
        options.note_others("view", target)  # before a wrong name is reported
    from needlefit.planning.steered_needle import read_recording
    from needlefit.viewer.opening import open_recording, open_target
    from needlefit.viewer.page_needle import compose_page

    source = None if recording is None else read_recording(recording)
    shown = open_target(target, specimen=specimen or "shown") if source is None else open_recording(source)
    screen.print_warnings(context.find_root().obj, shown.warnings)
    name = shown.name if recording is None else str(recording.with_suffix(""))
    path = write_page(folder, name, compose_page(shown, source))
    screen.print_line(str(path))
    if browser:
        import webbrowser

        webbrowser.open(path.resolve().as_uri())


def write_page(folder: Path, name: str, page: str) -> Path:
    """Write a page to a folder, in a file named by the last two parts of what it shows; return its path."""
    last = "-".join(PurePath(name.removesuffix(".toml")).parts[-2:])
    stem = re.sub(r"[^\w-]+", "-", last).strip("-")
    path = folder / f"{stem or 'needle'}.html"
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(page, "utf-8")
    return path


def plan(
    context: typer.Context,
    name: Annotated[
        str,
        argument(
            "SCENE | RUN[/ID] | DATASET/ID",
            "The needle to steer: a scene, a run's fitted insertion, or a measured one.",
        ),
    ],
    target: Annotated[
        str | None, option("Target in the constraint frame, mm: x along the entry.", "X,Y[,Z]")
    ] = None,
    radius: Annotated[
        float, option("Distance from the target that counts as reached.", "MM", min=0.01)
    ] = 2.0,
    obstacle: Annotated[
        list[str] | None,
        option("A sphere to avoid: centre and radius, mm. May be repeated.", "X,Y[,Z],R"),
    ] = None,
    markups: Annotated[
        Path | None,
        option(
            "Points of 3D Slicer (.mrk.json, .fcsv): the one labelled target..., all others obstacles.",
            "FILE",
        ),
    ] = None,
    obstacle_radius: Annotated[float, option("Radius of the obstacles of --markups.", "MM", min=0.01)] = 2.0,
    entry_shift: Annotated[float, option("Largest shift of the entry to either side.", "MM", min=0.0)] = 0.0,
    base: Annotated[float, option("Largest movement of the base to either side.", "MM", min=0.0)] = 10.0,
    base_angle: Annotated[
        float, option("Largest angle of the base to either side.", "DEGREES", min=0.0, max=40.0)
    ] = 5.0,
    turns: Annotated[int, option("Largest number of turns of the bevel on the way.", "N", min=0, max=2)] = 2,
    gain_sd: Annotated[
        float,
        option(
            "Of a run: SD of the part of each move of the base that reaches the needle.",
            "SD",
            min=0.0,
            max=1.0,
        ),
    ] = 0.0,
    specimen: options.Specimen = None,
    write_recording: Annotated[
        Path | None, option("Write the plan as a recording for `view` and `simulate`: .csv.", "FILE")
    ] = None,
) -> None:
    """Plan how to steer a needle to a target: entry, base, turns of the bevel.

    The plan has the greatest probability, over posterior draws of the parameters, that the tip ends within
    --radius and no obstacle is touched. A SCENE has one set of parameters, taken as exact. To a target off
    the plane z = 0 the bevel is rolled as the insertion begins, while the base moves along y; where that does
    not reach it, bevel and base are rolled together.

    Writes OUT/plan/NAME.html (default: ./reports), a page along whose plan the depth is dragged, with target,
    obstacles and the needles of the draws.
    """
    from needlefit.planning.steered_needle import write_recording as write_recording_file
    from needlefit.planning.steering import PlanLimits, plan_to_target
    from needlefit.project.unit_warnings import extrapolation_warnings
    from needlefit.reporting.needle_page import kernel_exists
    from needlefit.studies.run import mark_faults
    from needlefit.viewer.opening import open_target
    from needlefit.viewer.page_needle import compose_page

    outputs = {} if write_recording is None else {"--write-recording": write_recording}
    require_output_files(outputs, [] if markups is None else [markups])
    invocation = context.find_root().obj
    folder = invocation.out / "plan"
    require_writable(folder)
    options.note_others("plan", name)
    shown = open_target(name, specimen=specimen or "planned")
    shown = shown.vary_gain(gain_sd) if gain_sd else shown
    goal = _read_goal(shown, target, radius, obstacle or [], markups, obstacle_radius)
    limits = PlanLimits(entry_shift, base, base_angle, turns)
    insertion = shown.begin_insertion()
    plane, planned = plan_to_target(insertion, goal, limits, invocation.jobs)
    unfitted = planned.goal.directions > shown.fitted_directions
    depth = planned.steps[-1].depth
    beyond = tuple(extrapolation_warnings(depth, shown.fitted_depths, z_unfitted=unfitted))
    shown = replace(shown, warnings=(*shown.warnings, *beyond))
    recording = shown.record_plan(planned) if planned.hits else None
    if recording is not None and write_recording is not None:
        write_recording_file(recording, write_recording)
    page = None
    if recording is not None and kernel_exists():
        page = write_page(
            folder, shown.name, compose_page(shown.shift_entry(planned.entry_mm), recording, planned)
        )
    summary = _summarize(shown, plane, planned, len(insertion.samples[0])) | {"page": page and str(page)}
    if invocation.json:
        screen.show_json(summary)
    else:
        if verdict := _recall_verdict(shown):
            screen.print_text(verdict)
        screen.print_text(mark_faults(_list_faults(shown)) + _describe(shown, planned, summary))
    screen.print_warnings(invocation, shown.warnings)
    if recording is None:
        raise typer.Exit(exit_codes.NOT_CONVERGED)
    if not invocation.json:
        _show_steps(shown, summary)
    for path in (write_recording, page):
        if path is not None:
            screen.print_note(f"written: {path}")
    require_no_faults(f"{shown.name}: {fault}" for fault in _list_faults(shown))


def _list_faults(shown: "ViewedScene") -> "tuple[RunFault, ...]":
    """Return why the run of a needle is not to be trusted."""
    return shown.run.faults if shown.run else ()


def _recall_verdict(shown: "ViewedScene") -> str:
    """Return the verdict of the run of a needle, with the checks that failed; none of a scene."""
    from needlefit.studies.report import recall

    mark = f"{shown.origin_mark}. " if shown.origin_mark else ""
    return f"{mark}{recall(shown.run)}" if shown.run else ""


def _read_goal(
    shown: "ViewedScene",
    target: str | None,
    radius: float,
    obstacles: Sequence[str],
    markups: Path | None,
    obstacle_radius: float,
) -> "Goal":
    """Return the goal in space."""
    from needlefit.planning.goals import Goal, name_obstacles, read_goal_points
    from needlefit.schemas.scene import ObstacleRecord

    aim, stated = None, list[ObstacleRecord]()
    if markups is not None:
        aim, read = read_goal_points(markups, shown.find_placement(), obstacle_radius)
        stated += read
    if target is not None:
        x, y, *rest = read_numbers(target, (2, 3), "--target", "X,Y or X,Y,Z")
        aim = (x, y, rest[0] if rest else 0.0)
    if aim is None:
        raise typer.BadParameter(
            "give a target, or a point labelled `target` in --markups", param_hint="--target"
        )
    names = name_obstacles([*(obstacle.name for obstacle in stated), *([""] * len(obstacles))])
    for name, text in zip(names[len(stated) :], obstacles, strict=True):
        x, y, *rest, size = read_numbers(text, (3, 4), "--obstacle", "X,Y,R or X,Y,Z,R")
        if size <= 0:
            raise typer.BadParameter(f"the radius is {size:g} mm; expected above 0", param_hint="--obstacle")
        centre = (x, y, rest[0] if rest else 0.0)
        stated.append(ObstacleRecord(name=name, centre_mm=centre, radius_mm=size))
    return Goal(aim, radius, tuple(stated))


def _summarize(
    shown: "ViewedScene", plane: "PlaneGoal", planned: "SteeringPlan", search_draws: int
) -> dict[str, Any]:
    from needlefit.project.result_warnings import to_rows

    goal, exact = planned.goal, shown.spread is None
    return {
        "target_mm": list(goal.target),
        "radius_mm": goal.radius,
        "obstacles": [
            obstacle.model_dump(include={"name", "centre_mm", "radius_mm"}) for obstacle in goal.obstacles
        ],
        "obstacles_beside_the_plane": list(plane.beside),
        "roll_deg": plane.roll_deg,
        "entry_mm": planned.entry_mm,
        "turns_mm": list(planned.turns),
        "steps": planned.describe_steps() if planned.hits else [],
        **planned.describe_misses(),
        "fit_verdict": _recall_verdict(shown) or None,
        "specimen": shown.specimen or None,
        "draws": 0 if exact else len(planned.needles),
        "search_draws": 0 if exact else search_draws,
        "failed_solves": int((~planned.solved).sum()),
        "probability": None if exact else planned.probability,
        "low": None if exact else planned.low,
        "high": None if exact else planned.high,
        "reached": bool(planned.hits),
        "faults": list(map(str, _list_faults(shown))),
        "warnings": to_rows(shown.warnings),
    }


def _show_steps(shown: "ViewedScene", summary: dict[str, Any]) -> None:
    import pandas as pd

    screen.print_line()
    screen.print_text(shown.title)
    if summary["roll_deg"]:
        screen.print_line(f"Roll the needle by {summary['roll_deg']:z.1f} degrees about x, from y toward z,")
        screen.print_line("and move its base in that plane.")
    if abs(summary["entry_mm"]) > 0.005:
        screen.print_line(f"Shift the entry by {summary['entry_mm']:+.2f} mm along y.")
    rows = [
        {
            "Insert to mm": f"{step['depth_mm']:.2f}",
            "Bevel": f"roll {step['bevel_roll_deg']:z.1f}°"
            if "bevel_roll_deg" in step
            else "+y"
            if step["bevel_side"] > 0
            else "-y",
            "Base y mm": f"{step['base_y_mm']:.2f}",
            "Base angle °": f"{math.degrees(math.atan(step['base_slope'])):.2f}",
        }
        for step in summary["steps"]
    ]
    screen.show_frame(pd.DataFrame(rows), "Before each row set bevel and base, then insert:")
    if "tip_sd_mm" in summary:
        screen.print_line("A roll of 0 turns the bevel toward +y, 90 toward +z.")
    for name in summary["obstacles_beside_the_plane"]:
        screen.print_line(f"{name} lies beside the plane of the needle.")


def _describe(shown: "ViewedScene", planned: "SteeringPlan", summary: dict[str, Any]) -> str:
    past = " and touches no obstacle" if planned.goal.obstacles else ""
    within = f"within {planned.goal.radius:g} mm of the target"
    if not planned.hits:
        return f"No plan was found that reaches the target{past}: {_describe_failure(planned, summary)}."
    bound = "".join(f" The {control} is at its limit." for control in planned.at_limit)
    if shown.spread is None:
        nominal = f"{planned.nominal_miss:.2f} mm from it"
        scene = shown.run is None
        why = "for a probability, plan with a run" if scene else "the run has no certified draws"
        basis = f"The parameters of {shown.name} are taken as exact ({why}): the tip"
        reaches = "would reach" if _list_faults(shown) else "reaches"
        return f"The plan {reaches} the target{past}. {basis} ends {nominal}.{bound}"
    quantiles = (summary["median_mm"], summary["miss_95_mm"])
    median, most = ("-" if value is None else f"{value:.2f}" for value in quantiles)
    spread = ""
    if (sds := summary.get("tip_sd_mm")) is not None:  # not of a plan in the plane
        spread = f" Tips spread by {sds[0]:.2f} mm along y and {sds[1]:.2f} mm along z (SD)."
    return (
        f"The tip ends {within}{past} with probability {100 * planned.probability:.0f} % (95 % CI "
        f"{100 * planned.low:.0f} to {100 * planned.high:.0f} %), by {len(planned.needles)} posterior draws "
        f"for {_SPECIMENS[shown.specimen]}. "
        f"Median miss {median} mm, 95 % below {most} mm.{spread} "
        f"Model error is not included.{bound}"
    )


def _describe_failure(planned: "SteeringPlan", summary: dict[str, Any]) -> str:
    """Return how near the best plan comes, and what keeps it from the target."""
    near = summary["median_mm"]
    if near is None:
        return "on every way the needle leaves the model's limits"
    why = [f"the needle touches {name}" for name, share in planned.touched.items() if share]
    why += [f"the {control} is at its limit" for control in planned.at_limit]
    within = f", {planned.goal.radius:g} mm are allowed" if near > planned.goal.radius else ""
    kept = f" ({', '.join(why)})" if why else ""
    return f"the tip of the plan that comes nearest ends {near:.2f} mm from it{within}{kept}"


_SPECIMENS = {
    "new": "a new specimen, with the spread between specimens",
    "same": "a specimen that was fitted",
    "": "this insertion",
}
