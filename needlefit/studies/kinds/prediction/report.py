"""How a prediction is printed, tabulated and drawn."""

import itertools
import re
from typing import Any

import pandas as pd

from needlefit.inference.predictive_mixture import INTERVAL_PROBABILITIES
from needlefit.reporting.figures import Drawing, Look, Panel
from needlefit.reporting.labels import METHOD_COLOURS
from needlefit.reporting.number_format import format_to_error, is_known
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.run_metadata import PredictionMetadata
from needlefit.schemas.scene import SceneRecord
from needlefit.studies.first_page import Advice, FirstPage, Verdict, advise
from needlefit.studies.fit_tables import lay_out_estimates
from needlefit.studies.kinds.prediction.run import AXES
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Run

#: depths whose intervals are printed, as fractions of the length to the tip
PRINTED_DEPTHS = (0.25, 0.5, 0.75, 1.0)
BAND_COLOURS = {"95": "#BFDBEC", "50": "#7FB8D8"}  #: colours of bands by level, the widest first

TEXT = KindText("prediction")


def describe_prediction(run: Run) -> dict[str, Any]:
    """Return what the text prints."""
    study = run.record
    return {
        **vars(run.knows(PredictionMetadata)),
        **(tip := find_tip(run)),
        "side": _name_side(study.scene, tip["needle_predicted_mm"]),
        "title": study.scene.title or study.scene_name,
        "target": study.target,
        "faults": ", ".join(dict.fromkeys(fault.kind for fault in run.faults)),
    }


def _name_side(scene: SceneRecord, y: float) -> str:
    """Return to which side of the bevel a tip deflects; "" of a bevel that is rolled or turned."""
    if scene.bevel.roll_deg or any(step.side or step.roll_deg is not None for step in scene.steps):
        return ""
    return "toward the bevel" if scene.bevel.side * y > 0 else "away from the bevel"


def find_tip(run: Run) -> Row:
    """Return the tip's row, mm; None for the ends of bands that were left out."""
    return to_records(run.frames["forecast"].tail(1))[0]


def describe_forecast(run: Run) -> FirstPage:
    """Return where the tip will be, with its 95 % interval; it fails without one, and nothing is tested."""
    values = describe_prediction(run)
    keys = [name for name in values if re.fullmatch(r"s_mm|needle(_z)?_(predicted|95_low|95_high)_mm", name)]
    verdict = Verdict(
        TEXT.sentence("answer", values),
        "fail" if run.faults else "none",
        numbers={key: values[key] for key in (keys[:1] if run.faults else keys)},
    )
    tables = [*REPORT.lay_out(run), lay_out_estimates(run)]
    about, method = (TEXT.sentence(block, values) for block in ("about", "method"))
    return FirstPage(verdict, about, tables, advice=_advise_on_fit(run), method=method)


def _advise_on_fit(run: Run) -> Advice | None:
    """Return what to do: settle what the fit needs first, test it, narrow the interval, or plan a path."""
    stated, tip = run.knows(PredictionMetadata), find_tip(run)
    if run.faults:
        finding = "not_converged"
    elif (recalled := stated.fit_advice) is not None:
        return Advice(**{**recalled, "command": tuple(recalled["command"])})
    elif stated.fit_run is None:
        finding = "study_unvalidated" if stated.held_out_by_target else "fit_untested"
    elif tip["needle_95_high_mm"] - tip["needle_95_low_mm"] > stated.recipe.aiming_width_mm:
        finding = "prediction_wide"
    else:
        finding = "tip_predicted"
    axes = ("x_mm", "needle_predicted_mm", "needle_z_predicted_mm")
    place = ",".join(f"{tip[axis]:.2f}" for axis in axes if axis in tip)
    values = {"target": (target := run.record.target), "tip": place, "specimen": stated.specimen}
    if target.endswith("/") or ("/" in target and not target.endswith(".toml")):
        values["run"] = target  # the folder of a run, wherever it is
    return advise([finding], values, stated.fit_run or "")


def tabulate_prediction(run: Run) -> list[Table]:
    """Return the needle and its pointwise intervals at some depths, the tip the last."""
    frame = run.frames["forecast"]
    places = [round(part * (len(frame) - 1)) for part in PRINTED_DEPTHS]
    rows = [
        {key.removeprefix("needle_"): value for key, value in _round_ends(row).items()}
        for row in to_records(frame.iloc[places])
    ]
    columns = ["s_mm", "predicted_mm", *(f"range_{100 * level:.0f}_mm" for level in INTERVAL_PROBABILITIES)]
    columns += ["z_predicted_mm", "z_range_95_mm"] if "needle_z_predicted_mm" in frame else []
    return [Table("forecast", rows, columns)]


def _round_ends(row: Row) -> Row:
    """Return a row whose ends of intervals are texts, rounded by their Monte Carlo errors."""
    errors = {
        name.removesuffix("_error_mm") + "_mm": error
        for name, error in row.items()
        if name.endswith("_error_mm") and is_known(error)
    }
    return row | {name: format_to_error(row[name], error) for name, error in errors.items()}


def draw_prediction(run: Run) -> dict[str, Drawing]:
    """Return the predicted needle and its 50 and 95 % simultaneous bands, mm."""
    facts = describe_prediction(run)
    title = f"{facts['title']} ({facts['faults']})" if run.faults else facts["title"]
    table = run.frames["forecast"].assign(scene=title)
    bands = {level: (f"simultaneous {level} % band", colour) for level, colour in BAND_COLOURS.items()}
    names = {name: Look(*band, width=6.0, white=0.0) for name, band in bands.items()}
    predicted = "predicted needle" if facts["mode_fault"] == "none" else "predictive median"
    names["needle"] = Look(predicted, METHOD_COLOURS["fitted"], width=1.4)
    if run.faults:  # whose bands are left out
        names = {"needle": names["needle"]}
    axes = [axis for axis in AXES if f"needle_{axis}predicted_mm" in table]
    options: dict[str, Any] = {
        **{"x": "x_mm", "by": "band", "looks": names, "size": (7.16, 1.0 + 1.6 * len(axes))},
        "x_label": "x along the entry (mm)",
        "panels": [
            Panel(f"{name} (mm)", line=f"{axis}predicted_mm", low=f"{axis}low_mm", high=f"{axis}high_mm")
            for name, axis in zip("yz", axes, strict=False)
        ],
    }

    def list_bands(table: pd.DataFrame) -> pd.DataFrame:
        """Return a row for each band and point, and for the needle."""
        lines = {f"{axis}predicted_mm": table[f"needle_{axis}predicted_mm"] for axis in axes}
        parts = [table.assign(band="needle", **lines)]
        for level in bands:
            ends = itertools.product(axes, ("low", "high"))
            named = {f"{axis}{end}_mm": table[f"band_{axis}{level}_{end}_mm"] for axis, end in ends}
            parts.append(table.assign(band=level, **named))
        return pd.concat(parts, ignore_index=True)

    return {"forecast": Drawing("forms.curves", table, options, list_bands)}


REPORT = StudyReport(TEXT, describe_prediction, tabulate_prediction, draw_prediction, describe_forecast)
