"""Report of a compression test: table, curves, profiles, and the prior of a layer."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.inference.specimen_fit import ALPHA_RANGE
from needlefit.project.result_warnings import read_warnings
from needlefit.project.toml_text import dumps
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid, plot
from needlefit.reporting.labels import GREY, INK
from needlefit.reporting.number_format import format_quantity
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.kinds.material.run import FURTHER_SPECIMEN, PRIOR_LABEL
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.verdict import Status

_SPECIMEN_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")  # Okabe and Ito
_MAX_NAMED_SPECIMENS = 8
"""More specimens than these are not named one by one."""

_FLOOR, _BAR = -8.0, 0.3
"""Log likelihood at which the profiles are cut off; height of a bar below."""

_MAX_DOTS = 60
"""Measured points of a specimen that are drawn, about."""


def draw_curves(curves: pd.DataFrame, path: Path) -> Path:
    """Draw measured and fitted stress over stretch, and the residuals below."""
    return plot(path, curves, _paint_curves)


def draw_profiles(profiles: pd.DataFrame, path: Path) -> Path:
    """Draw the profile log-likelihoods of alpha, their 95 % regions, and the resulting prior."""
    return plot(path, profiles, _paint_profiles)


def _paint_curves(curves: pd.DataFrame) -> Figure:
    figure = Figure(figsize=(0.6 * TEXT_WIDTH_IN, 3.3))
    upper, lower = figure.subplots(2, 1, height_ratios=(2.2, 1), sharex=True)
    for colour, (name, rows) in _iterate_coloured(curves):
        dots = rows.iloc[:: max(1, len(rows) // _MAX_DOTS)]
        style = {"ms": 2.4, "mfc": "none", "mew": 0.6}
        upper.plot(dots["stretch"], -dots["measured_pa"] / 1e3, "o", color=colour, **style)
        line = rows.sort_values("stretch")
        upper.plot(line["stretch"], -line["fitted_pa"] / 1e3, color=colour, lw=1.1, label=name)
        lower.plot(rows["stretch"], rows["residual_pa"] / 1e3, color=colour, lw=0.8)
    upper.invert_xaxis()
    upper.set_ylabel(f"{curves['measure'].iloc[0]} stress (kPa),\npositive in compression")
    lower.axhline(0.0, color=INK, lw=0.5)
    lower.set_ylabel("fitted minus\nmeasured (kPa)")
    lower.set_xlabel("stretch")
    for axes in (upper, lower):
        draw_grid(axes, "y")
    if 1 < curves["specimen"].nunique() <= _MAX_NAMED_SPECIMENS:
        upper.legend(loc="upper left", fontsize=6.5, handlelength=1.2, labelspacing=0.3)
    return figure


def _paint_profiles(profiles: pd.DataFrame) -> Figure:
    figure = Figure(figsize=(0.6 * TEXT_WIDTH_IN, 3.0))
    axes = figure.add_subplot()
    specimens = profiles[profiles["specimen"] != PRIOR_LABEL]
    for n, (colour, (name, rows)) in enumerate(_iterate_coloured(specimens)):
        shown = rows["log_likelihood"].where(rows["log_likelihood"] >= _FLOOR)
        axes.plot(rows["alpha"], shown, color=colour, lw=1.1, label=name)
        bar = rows["alpha"].where(rows["in_95_region"].astype(bool))
        level = np.full(len(rows), _FLOOR - _BAR * (n + 0.5))
        axes.plot(bar, level, color=colour, lw=2, solid_capstyle="butt")
    _format_profile_axes(axes, profiles, specimens)
    return figure


def _format_profile_axes(axes: Axes, profiles: pd.DataFrame, specimens: pd.DataFrame) -> None:
    count = specimens["specimen"].nunique()
    axes.set_title("profile log likelihood of α; bars: 95 % region", loc="left")
    axes.set_ylim(_FLOOR - _BAR * (count + 0.5), 0.6)
    prior = profiles.loc[profiles["specimen"] == PRIOR_LABEL, "alpha"]
    ends = [*specimens.loc[specimens["in_95_region"].astype(bool), "alpha"], *prior]
    margin = 0.5 * (max(ends) - min(ends)) + 0.1
    axes.set_xlim(min(ends) - margin, max(ends) + margin)
    axes.set_xlabel("α")
    if len(prior):
        axes.axvspan(prior.min(), prior.max(), color=GREY, alpha=0.2, lw=0, label="prior, ± one SD")
    if len(prior) or 1 < count <= _MAX_NAMED_SPECIMENS:
        axes.legend(loc="upper right", fontsize=6.5, handlelength=1.2, labelspacing=0.3)
    draw_grid(axes, "y")


def _iterate_coloured(rows: pd.DataFrame) -> Iterator[tuple[str, tuple[str, pd.DataFrame]]]:
    """Yield a colour, and the name and rows of each specimen."""
    for n, (name, group) in enumerate(rows.groupby("specimen", sort=False)):
        yield _SPECIMEN_COLOURS[n % len(_SPECIMEN_COLOURS)], (str(name), group)


FOUNDATION_MODULUS_NOTE = (
    "This mu is the shear modulus of the material. The model's mu is a foundation modulus, which also "
    "depends on how the needle moves the tissue around it; a compression test does not determine that"
)
FOUNDATION_OPTION = "--foundation FACTOR SPREAD"


def select_specimens(found: Run) -> list[Row]:
    """Return the rows of the specimens, without that of a further one."""
    return [row for row in to_records(found.frames["material"]) if row["specimen"] != FURTHER_SPECIMEN]


def summarize_material(found: Run) -> list[str]:
    """Return sentences: what the test determines, and what it does not."""
    flat = [
        describe_flat_region(found, row) for row in select_specimens(found) if not row["alpha_identified"]
    ]
    if found.run["prior"] is None:
        return ["No specimen identifies alpha: no prior is written.", *flat]
    foundation = found.run["study"]["foundation"]
    end = f"Its prior is written only with {FOUNDATION_OPTION}."
    if foundation is not None:
        factor, spread = foundation
        end = f"Its prior uses the stated factor of {factor:g}, known within a factor of {spread:g}."
    return [_describe_known(found), *_describe_spread(found), *flat, f"{FOUNDATION_MODULUS_NOTE}. {end}"]


def rate(found: Run) -> Status:
    """Return "fail" if no specimen identifies alpha, "warn" if some do not."""
    identified = [bool(row["alpha_identified"]) for row in select_specimens(found)]
    return "pass" if all(identified) else "warn" if any(identified) else "fail"


def list_regions(found: Run, specimen: str) -> list[tuple[float, float]]:
    """Return the 95 % regions of alpha of a specimen."""
    rows = found.frames["regions"]
    rows = rows[rows["specimen"] == specimen]
    return list(zip(rows["low"].tolist(), rows["high"].tolist(), strict=True))


def judge_alpha(found: Run, row: Row) -> str:
    """Return one word: whether a specimen identifies alpha."""
    if row["alpha_identified"]:
        return "identified"
    return "one of several" if len(list_regions(found, row["specimen"])) > 1 else "not identified"


def describe_flat_region(found: Run, row: Row) -> str:
    """Return the range of alpha over which the fit to one specimen hardly changes."""
    low, high, regions = row["stretch_min"], row["stretch_max"], list_regions(found, row["specimen"])
    at = f"Specimen {row['specimen']} does not identify alpha at its stretches of {low:.3g} to {high:.3g}"
    flat = " and ".join(_format_region(region) for region in regions)
    summary = f"{at}: the 95 % region is {flat}."
    if len(regions) > 1:
        summary += (
            " Where one of the law's two powers dominates, alpha and -2 alpha give the same curve; only small"
            " compressions distinguish them."
        )
    return summary


def list_pooled(found: Run) -> list[str]:
    """Return the specimens whose alpha the test identifies."""
    return [row["specimen"] for row in select_specimens(found) if row["alpha_identified"]]


def describe_prior(found: Run) -> str:
    """Return a description of the prior: its sources, and what it does not include."""
    pooled = list_pooled(found)
    if len(pooled) == 1:
        return f"one specimen, {pooled[0]}: the spread between specimens is not known and not included"
    return f"a further specimen like these {len(pooled)}: their spread is included"


def _describe_known(found: Run) -> str:
    row, count = to_records(found.frames["material"])[-1], len(list_pooled(found))
    mu = f"mu = {format_quantity('mu_pa', row['mu_pa'])} ± {100 * row['sd_ln_mu']:.2g} %"
    source = "1 specimen" if count == 1 else f"{count} specimens"
    alpha = f"alpha = {row['alpha']:.3g} ± {row['sd_alpha']:.2g}"
    return f"{alpha}, {mu} (± SD, for a further specimen; from {source})."


def _describe_spread(found: Run) -> list[str]:
    """Return the spread between specimens, as far as it is known."""
    if len(list_pooled(found)) == 1:
        return ["One specimen does not determine the spread between specimens: these SDs are too small."]
    between = to_records(found.frames["material"])[-1]["between_sd_alpha"]
    return [f"SD of alpha between specimens: {between:.2g}."]


def _format_region(region: tuple[float, float]) -> str:
    low, high = (f"{end:.3g}" for end in region)
    low = "below " + low if region[0] <= ALPHA_RANGE[0] else low
    high = "above " + high if region[1] >= ALPHA_RANGE[1] else high
    return f"{low} to {high}"


_NOTES = (
    "μ is the material's shear modulus, not the model's foundation modulus. r: correlation of neighbouring "
    "residuals; independent points: their effective number.",
)


_COLUMNS = (
    *("specimen", "points", "stretch_min", "mu_kpa", "alpha", "alpha_regions_95", "residual_percent"),
    *("neighbours_correlation", "independent_points", "alpha_verdict"),
)


def lay_out_material(found: Run) -> TableLayout:
    """Return the table of specimens."""
    rows = [_describe_specimen(found, row) for row in select_specimens(found)]
    caption = f"One-term Ogden solid fitted to {found.run['measure']} stress in uniaxial compression."
    return Table("material", caption, rows, _COLUMNS, notes=_NOTES).lay_out()


def _describe_specimen(found: Run, row: Row) -> Row:
    curves = found.frames["curves"]
    size = float(np.max(np.abs(curves.loc[curves["specimen"] == row["specimen"], "measured_pa"])))
    regions = [f"{low:.2f} to {high:.2f}" for low, high in list_regions(found, row["specimen"])]
    known = {"mu_kpa": row["mu_pa"] / 1e3} if row["alpha_identified"] else {"mu_kpa": None, "alpha": None}
    return {
        **row,
        **known,
        "alpha_regions_95": " or ".join(regions).replace("-", "−"),
        "residual_percent": f"{100 * row['residual_sd_pa'] / size:.2g}",
        "alpha_verdict": judge_alpha(found, row),
    }


def draw_figures(found: Run, folder: Path) -> dict[str, Path]:
    """Draw curves with their residuals, and the profiles of alpha."""
    drawn = {"curves": draw_curves, "profiles": draw_profiles}
    return {name: paint(found.frames[name], folder / f"{name}.pdf") for name, paint in drawn.items()}


def compose_sections(found: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: the specimens, and both figures."""
    captions = {
        "curves": "Measured (circles) and fitted (lines) stress over stretch, and fitted minus measured.",
        "profiles": "Profile log likelihood of α of each specimen.",
    }
    return [
        document.heading("Specimens"),
        document.table(lay_out_material(found)),
        *(document.figure(path, captions[name]) for name, path in figures.items()),
    ]


def write_prior(found: Run, folder: Path) -> None:
    """Write the prior of a layer, if some specimen identifies alpha."""
    if found.run["prior"] is not None:
        (folder / "prior.toml").write_text(_format_prior_file(found), encoding="utf-8")


def _format_prior_file(found: Run) -> str:
    head = [
        "# What a compression test determines of one layer. A fit or study takes it, here for layer 1, by",
        '#     priors = { 1 = "the/path/of/this/file/prior.toml" }',
    ]
    tables = {"schema": 1, "title": found.dataset_title, "note": describe_prior(found)}
    tables |= {"sha256": found.run["sha256"], **found.run["prior"]}
    return "\n".join(head) + "\n" + dumps(tables)


def material_to_json(found: Run) -> dict[str, Any]:
    """Return the result as JSON values."""
    summary = [*summarize_material(found), *(one.what for one in read_warnings(found.run))]
    cells = (row.items() for row in to_records(found.frames["material"]))
    rows = [{name: value for name, value in row if value is not None} for row in cells]
    return {"name": found.name, "summary": summary, "specimens": rows, "prior": found.run["prior"]}


REPORT = StudyReport(
    summarize_material,
    lambda found: [lay_out_material(found)],
    draw_figures,
    compose_sections,
    write_prior,
    material_to_json,
    rate=rate,
)
