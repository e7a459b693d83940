"""Write the analysis of a compression test: table, files, figures, and the prior of a layer."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.datasets.compression import CompressionTest
from needlefit.datasets.formats.toml import dumps
from needlefit.inference.material import MaterialEstimate, MaterialFoundation, make_material_prior
from needlefit.inference.specimen_fit import ALPHA_RANGE, SpecimenFit
from needlefit.mechanics.compression import StressMeasure
from needlefit.project.atomic_write import replace_folder
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid, plot
from needlefit.reporting.labels import GREY, INK
from needlefit.reporting.material_tables import (
    PRIOR_LABEL,
    describe_prior,
    judge_alpha,
    summarize_material,
    tabulate_curves,
    tabulate_material,
    tabulate_profiles,
)
from needlefit.reporting.number_format import format_number
from needlefit.reporting.table_files import write_csv, write_json
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.validation.provenance import package_versions

_SPECIMEN_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")  # Okabe and Ito
_MAX_NAMED_SPECIMENS = 8
"""More specimens than these are not named one by one."""

_FLOOR, _BAR = -8.0, 0.3
"""Log likelihood at which the profiles are cut off; height of a bar below."""

_MAX_DOTS = 60
"""Measured points of a specimen that are drawn, about."""


def draw_curves(measure: StressMeasure, curves: pd.DataFrame, path: Path) -> Path:
    """Draw measured and fitted stress over stretch, and the residuals below."""
    return plot(path, curves, lambda frame: _paint_curves(measure, frame))


def draw_profiles(profiles: pd.DataFrame, path: Path) -> Path:
    """Draw the profile log-likelihoods of alpha, their 95 % regions, and the resulting prior."""
    return plot(path, profiles, _paint_profiles)


def _paint_curves(measure: StressMeasure, curves: pd.DataFrame) -> Figure:
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
    upper.set_ylabel(f"{measure} stress (kPa),\npositive in compression")
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
        axes.axvspan(prior.min(), prior.max(), color=GREY, alpha=0.2, lw=0, label="prior, ± one sd")
    if len(prior) or 1 < count <= _MAX_NAMED_SPECIMENS:
        axes.legend(loc="upper right", fontsize=6.5, handlelength=1.2, labelspacing=0.3)
    draw_grid(axes, "y")


def _iterate_coloured(rows: pd.DataFrame) -> Iterator[tuple[str, tuple[str, pd.DataFrame]]]:
    """Yield a colour, and the name and rows of each specimen."""
    for n, (name, group) in enumerate(rows.groupby("specimen", sort=False)):
        yield _SPECIMEN_COLOURS[n % len(_SPECIMEN_COLOURS)], (str(name), group)


_PACKAGES = ("numpy", "scipy")
_NOTES = (
    "μ is the material's shear modulus, not the model's foundation modulus. “r” is the correlation of "
    "neighbouring residuals, “worth” the independent points that are left of n for it.",
)


@dataclass(frozen=True)
class MaterialReport:
    """One compression test and its results; `foundation` is what the user states about the model's mu."""

    name: str
    test: CompressionTest
    material: MaterialEstimate
    foundation: MaterialFoundation | None = None


def lay_out_material(report: MaterialReport) -> TableLayout:
    """Return the table of specimens."""
    columns = (
        *(
            text_column("Specimen"),
            TableColumn("n"),
            TableColumn("Stretch to"),
            TableColumn("μ", "kPa"),
            TableColumn("α"),
        ),
        *(
            text_column("95 % of α"),
            TableColumn("Residual", "%"),
            TableColumn("r"),
            TableColumn("Worth"),
            text_column("α is"),
        ),
    )
    rows = tuple(_specimen_cells(fit) for fit in report.material.fits)
    measure = report.test.measure
    caption = f"One-term Ogden solid fitted to {measure} stress in uniaxial compression."
    return TableLayout("material", caption, columns, rows, (), (), _NOTES)


def write_material(report: MaterialReport, folder: Path) -> list[Path]:
    """Write table, curves, profiles and prior to `folder`, replacing an earlier result there.

    Returns the files; beside the tables of curves and profiles lie their figures. `prior.toml` is written
    only if some specimen identifies alpha.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    material = report.material
    with replace_folder(folder) as new:
        write_csv(pd.DataFrame(tabulate_material(material)), new / "material.csv")
        draw_curves(report.test.measure, tabulate_curves(material), new / "curves.pdf")
        draw_profiles(tabulate_profiles(material), new / "profiles.pdf")
        if material.alpha_identified:
            (new / "prior.toml").write_text(format_prior_file(report), encoding="utf-8")
        write_json(new / "material.json", material_to_json(report))
        write_json(new / "run.json", material_provenance(report))
    return sorted(folder.iterdir())


def material_to_json(report: MaterialReport) -> dict[str, Any]:
    """Return the result as JSON values."""
    summary = [*summarize_material(report.material, report.foundation), *report.test.warnings]
    prior = _make_prior_tables(report) if report.material.alpha_identified else None
    return {
        "name": report.name,
        "summary": summary,
        "specimens": tabulate_material(report.material),
        "prior": prior,
    }


def material_provenance(report: MaterialReport) -> dict[str, Any]:
    """Return the provenance of the fit, sufficient to repeat it; without times or paths."""
    return {
        "name": report.name,
        "versions": package_versions(_PACKAGES),
        "file": report.test.path.name,
        "sha256": report.test.digest,
        "columns": list(report.test.columns),
        "measure": report.test.measure,
        "law": "ogden, one term, incompressible: energy 2 mu / alpha^2 (sum lambda^alpha - 3)",
        "alpha_range": list(ALPHA_RANGE),
        "foundation": None if report.foundation is None else asdict(report.foundation),
        "warnings": list(report.test.warnings),
    }


def format_prior_file(report: MaterialReport) -> str:
    """Return the text of `prior.toml`."""
    head = [
        "# What a compression test says of one layer. A fit or study takes it, here for layer 1, by",
        '#     priors = { 1 = "the/path/of/this/file/prior.toml" }',
    ]
    tables = {"schema": 1, "title": report.test.path.name, "note": describe_prior(report.material)}
    tables |= {"sha256": report.test.digest, **_make_prior_tables(report)}
    return "\n".join(head) + "\n" + dumps(tables)


def _make_prior_tables(report: MaterialReport) -> dict[str, Mapping[str, Any]]:
    alpha, mu = make_material_prior(report.material, report.foundation)
    stated = {"alpha": alpha} if mu is None else {"alpha": alpha, "mu_pa": mu}
    return {name: one.model_dump(exclude_defaults=True) for name, one in stated.items()}


def _specimen_cells(fit: SpecimenFit) -> tuple[str, ...]:
    size = float(np.max(np.abs(fit.specimen.stress)))
    ranges = " or ".join(f"{low:.2f} to {high:.2f}" for low, high in fit.profile.regions)
    return (
        *(fit.specimen.name, str(len(fit.residuals)), f"{fit.specimen.stretch.min():.3f}"),
        format_number(1e3 * fit.mu) if fit.identified else "–",
        f"{fit.alpha:.2f}".replace("-", "−") if fit.identified else "–",
        ranges.replace("-", "−"),
        f"{100 * fit.noise / size:.2g}",
        f"{fit.neighbour_correlation:.2f}",
        f"{fit.effective_points:.0f}",
        judge_alpha(fit),
    )
