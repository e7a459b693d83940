"""`needlefit predict --medium`: the tip of a planned insertion before any data, by priors alone."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import typer

from needlefit.cli import screen
from needlefit.cli.options import read_numbers

if TYPE_CHECKING:
    from needlefit.planning.prior_forecast import PriorForecast
    from needlefit.schemas.scene import SceneRecord

_POSE_ERRORS = {"pose_shift_mm": "place of the entry", "pose_angle_deg": "direction at the entry"}
MIN_SHOWN_SHARE = 0.005  # smallest share of the tip's variance of a parameter that is listed


def predict_before_data(
    context: typer.Context,
    scene: "tuple[str, SceneRecord]",
    changed: Sequence[str],
    medium: str,
    aim: str | None,
    radius: float,
    pose_sds: str,
) -> None:
    """Print where the tip of a scene will be by draws from the priors of a tissue model, or published moduli.

    `scene`: what messages call it, and its keys, of which the user `changed` some.
    """
    from needlefit.mechanics.published import read_moduli
    from needlefit.planning.prior_forecast import describe_published, forecast_by_prior, list_published
    from needlefit.project.locate import is_path, list_names, unknown_name_error
    from needlefit.project.toml import find_named, load
    from needlefit.schemas.medium import MediumRecord
    from needlefit.studies.kinds.prediction.scene import make_scene

    name, planned = scene
    if published := list_published(medium):
        model = describe_published(published, len(planned.layers), planned.rules.advance)
    elif is_path(medium) or medium in (media := list_names("medium")):
        model = load(find_named("medium", medium), MediumRecord)
    else:
        raise unknown_name_error("medium", medium, [*media, *read_moduli()])
    target = None if aim is None else read_numbers(aim, (2, 3), "--aim", "X,Y or X,Y,Z")
    shift, angle = map(abs, read_numbers(pose_sds, (2, 2), "--pose-sd", "SHIFT,DEGREES"))
    planned_scene = make_scene(planned, name, model, changed)
    forecast = forecast_by_prior(
        planned_scene, model, radius, target, context.find_root().obj.seed or 1, (shift, angle)
    )
    if context.find_root().obj.json:
        sources = [source._asdict() for source in published]
        screen.show_json(
            {"scene": name, "medium": medium, **_summarize(forecast, radius), "sources": sources}
        )
        return
    _show(forecast, radius, "median tip" if target is None else "target")
    for source in published:
        screen.print_text(
            f"{source.name}: {source.quantity} {source.low:g} to {source.high:g} kPa ({source.source})."
        )
    if published:
        screen.print_text("A fitted μ may differ: it is no material constant.")


def _summarize(forecast: "PriorForecast", radius: float) -> dict[str, object]:
    ends = ("median", "low", "high")
    return {
        **{
            f"tip_{axis}_mm": dict(zip(ends, forecast.interval(n), strict=True))
            for n, axis in enumerate("xyz")
        },
        "target_mm": forecast.target.tolist(),
        "radius_mm": radius,
        "hits": forecast.hits,
        "parameters": [
            {
                "parameter": name,
                "low": forecast.priors[name][0],
                "high": forecast.priors[name][1],
                "share": share,
            }
            for name, share in forecast.shares.items()
        ],
        "draws": len(forecast.tips),
        "failed": forecast.failed,
        "outside_validity": forecast.outside,
    }


def _show(forecast: "PriorForecast", radius: float, aim: str) -> None:
    """Print the tip, the chance of a hit, and the parameters that matter."""
    import pandas as pd

    from needlefit.reporting.number_format import format_bare_symbol, format_quantity_range

    places = []
    for axis, (median, low, high) in (("y", forecast.interval(1)), ("z", forecast.interval(2))):
        if axis == "y" or high > low:
            places.append(f"{axis} = {median:z.2f} mm (95 % interval {low:z.2f} to {high:z.2f} mm)")
    first, most = next(iter(forecast.shares.items()))
    subject = f"The {_POSE_ERRORS[first]}" if first in _POSE_ERRORS else format_bare_symbol(first)
    names = {name: _POSE_ERRORS.get(name) or format_bare_symbol(name) for name in forecast.shares}
    screen.print_text(
        f"Before any data the tip is predicted at {', '.join(places)}. It ends within {radius:g} mm of the "
        f"{aim} in {100 * forecast.hits:.0f} % of {len(forecast.tips)} draws. {subject} "
        f"dominates: {100 * most:.0f} % of the variance of the tip."
    )
    rows = [
        {
            "parameter": names[name],
            "95 % of its prior": format_quantity_range(name, *forecast.priors[name]),
            "part of the variance": f"{100 * share:.0f} %",
        }
        for name, share in forecast.shares.items()
        if share >= MIN_SHOWN_SHARE
    ]
    screen.show_frame(pd.DataFrame(rows), "")
    if forecast.failed or forecast.outside:
        outside = f"{forecast.outside} needles are outside what the model assumes"
        screen.print_text(f"{forecast.failed} draws cannot be solved; {outside}.")
