"""Fit the Ogden law to every specimen of a compression test, and pool them to the prior of a layer."""

from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from needlefit.datasets.compression import read_compression
from needlefit.inference.material import (
    ALPHA_RANGE,
    MaterialEstimate,
    MaterialFoundation,
    SpecimenFit,
    fit_material,
    make_material_prior,
)
from needlefit.project.result_warnings import ResultWarning, read_warnings, warnings_entry
from needlefit.project.toml import dumps
from needlefit.reporting.figures import Drawing, Panel
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.analyses import AnalysisRecord
from needlefit.studies.job import Settings
from needlefit.studies.kind import StudyKind
from needlefit.studies.provenance import package_versions
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Run, Status


class CompressionRecord(AnalysisRecord):
    """`kind = "material"`: a prior from a compression test."""

    kind: Literal["material"]
    file: str
    """Table of the compression test."""
    stress: Literal["nominal", "true"] | None = None
    """What column `stress_kpa` holds: force per initial area (nominal) or per present area (true)."""
    foundation: tuple[float, float] | None = None
    """Factor from the material's shear modulus to the model's mu, and the factor within which it is
    known."""


KIND = StudyKind("material", CompressionRecord, __name__)  #: what `needlefit material` runs, or a study file

_PACKAGES = ("numpy", "scipy")

#: stands for a specimen in the last row of the frame "material", if alpha is known
FURTHER_SPECIMEN = "(a further one)"


def run(name: str, record: CompressionRecord, settings: Settings) -> Run:
    """Fit the test in `record.file`.

    Raises ConfigError or DataError if the file, or the stated foundation factor, is missing or wrong.
    """
    foundation = None if record.foundation is None else MaterialFoundation(*record.foundation)
    test = read_compression(Path(record.file), record.stress)
    material = fit_material(test)
    named = {"file": test.path.name, "title": record.title or f"Compression test {test.path.name}"}
    stored, prior = record.model_copy(update=named), None
    if material.alpha_identified:
        alpha, mu = make_material_prior(material, foundation)
        stated = {"alpha": alpha} if mu is None else {"alpha": alpha, "mu_pa": mu}
        prior = {key: one.model_dump(exclude_defaults=True) for key, one in stated.items()}
    return Run(
        kind=record.kind,
        name=name,
        record=stored,
        origin="measured",
        dataset_title=test.path.name,
        frames={
            "material": pd.DataFrame(_tabulate_material(material)),
            "regions": pd.DataFrame(
                [(fit.specimen.name, *region) for fit in material.fits for region in fit.profile.regions],
                columns=["specimen", "low", "high"],
            ),
            "curves": pd.concat([_specimen_curve(fit) for fit in material.fits], ignore_index=True),
            "profiles": _tabulate_profiles(material),
        },
        run={
            "name": name,
            "versions": package_versions(_PACKAGES),
            "study": stored.model_dump(mode="json", by_alias=True),
            "sha256": test.digest,
            "columns": list(test.columns),
            "measure": test.measure,
            "law": "ogden, one term, incompressible: energy 2 mu / alpha^2 (sum lambda^alpha - 3)",
            "alpha_range": list(ALPHA_RANGE),
            "prior": prior,
            **warnings_entry(ResultWarning("compression_test", what) for what in test.warnings),
        },
        timing={},
    )


def _tabulate_material(material: MaterialEstimate) -> list[dict[str, Any]]:
    """Return one row per specimen, and one for a further specimen if alpha is known."""
    rows = [_specimen_row(fit) for fit in material.fits]
    if material.alpha_identified:
        sd_log_mu, sd_alpha = material.sds
        log_mu, alpha = material.mean.tolist()
        rows.append(
            {
                "specimen": FURTHER_SPECIMEN,
                "mu_pa": float(np.exp(log_mu)) * 1e6,
                "sd_ln_mu": sd_log_mu,
                "alpha": alpha,
                "sd_alpha": sd_alpha,
                "correlation": float(material.covariance[0, 1]) / (sd_log_mu * sd_alpha),
                "between_sd_ln_mu": float(np.sqrt(material.between[0, 0])),
                "between_sd_alpha": float(np.sqrt(material.between[1, 1])),
                "alpha_identified": True,
            }
        )
    return rows


def _specimen_row(fit: SpecimenFit) -> dict[str, Any]:
    sd_log_mu, sd_alpha = fit.sds
    return {
        "specimen": fit.specimen.name,
        "measure": fit.measure,
        "points": len(fit.residuals),
        "stretch_min": float(fit.specimen.stretch.min()),
        "stretch_max": float(fit.specimen.stretch.max()),
        "mu_pa": 1e6 * fit.mu,
        "sd_ln_mu": sd_log_mu,
        "alpha": fit.alpha,
        "sd_alpha": sd_alpha,
        "correlation": float(fit.covariance[0, 1]) / (sd_log_mu * sd_alpha),
        "alpha_regions_95": " or ".join(f"{low:.4g} to {high:.4g}" for low, high in fit.profile.regions),
        "alpha_identified": fit.identified,
        "other_alphas": " ".join(f"{other:.4g}" for other in fit.other_alphas),
        "residual_sd_pa": 1e6 * fit.noise,
        "neighbours_correlation": fit.neighbour_correlation,
        "independent_points": fit.effective_points,
    }


#: stands for a specimen in rows of the frame "profiles" that hold the ends of the prior of alpha
PRIOR_LABEL = "(prior, ± one sd)"


def _tabulate_profiles(material: MaterialEstimate) -> pd.DataFrame:
    """Return the profiles of alpha, each 0 at its peak, then the ends of the prior, if there is one."""
    found = [
        pd.DataFrame(
            {
                "specimen": fit.specimen.name,
                "alpha": fit.profile.alpha,
                "mu_pa": 1e6 * fit.profile.mu,
                "log_likelihood": -0.5 * fit.effective_points * np.log(fit.profile.ratio),
                "in_95_region": fit.profile.ratio <= fit.profile.limit,
            }
        ).replace({np.inf: np.nan, -np.inf: np.nan})  # of what no positive mu fits
        for fit in material.fits
    ]
    if material.alpha_identified:
        ends = [float(material.mean[1]) + side * material.sds[1] for side in (-1.0, 1.0)]
        found.append(pd.DataFrame({"specimen": PRIOR_LABEL, "alpha": ends, "in_95_region": False}))
    return pd.concat(found, ignore_index=True)


def _specimen_curve(fit: SpecimenFit) -> pd.DataFrame:
    """Return measured and fitted stress, Pa, negative in compression."""
    measured = 1e6 * fit.specimen.stress
    return pd.DataFrame(
        {
            "specimen": fit.specimen.name,
            "measure": fit.measure,
            "stretch": fit.specimen.stretch,
            "measured_pa": measured,
            "fitted_pa": measured + 1e6 * fit.residuals,
            "residual_pa": 1e6 * fit.residuals,
        }
    )


# ---- the report

TEXT = KindText("material")


def describe(found: Run) -> dict[str, Any]:
    """Return what the text prints."""
    rows = list_specimens(found)
    return {
        "measure": found.run["measure"],
        "prior": found.run["prior"] is not None,
        "foundation": found.run["study"]["foundation"],
        "pooled": [row["specimen"] for row in rows if row["alpha_identified"]],
        "further": to_records(found.frames["material"])[-1],
        "flat": [row for row in rows if not row["alpha_identified"]],
    }


def list_specimens(found: Run) -> list[Row]:
    """Return the rows of the specimens with their 95 % regions of alpha, without that of a further one."""
    regions = found.frames["regions"].assign(
        open_low=lambda frame: frame["low"] <= ALPHA_RANGE[0],
        open_high=lambda frame: frame["high"] >= ALPHA_RANGE[1],
    )
    return [
        {**row, "regions": to_records(regions[regions["specimen"] == row["specimen"]])}
        for row in to_records(found.frames["material"])
        if row["specimen"] != FURTHER_SPECIMEN
    ]


def rate(found: Run) -> Status:
    """Return "fail" if no specimen identifies alpha, "warn" if some do not."""
    identified = [bool(row["alpha_identified"]) for row in list_specimens(found)]
    return "pass" if all(identified) else "warn" if any(identified) else "fail"


_COLUMNS = (
    *("specimen", "points", "stretch_min", "mu_kpa", "alpha", "alpha_regions_95", "residual_percent"),
    *("neighbours_correlation", "independent_points", "alpha_verdict"),
)


def tabulate(found: Run) -> list[Table]:
    rows, stress = [], found.frames["curves"].groupby("specimen")["measured_pa"]
    size = stress.agg(lambda values: np.max(np.abs(values)))
    for row in list_specimens(found):
        identified = row["alpha_identified"]
        regions = " or ".join(f"{one['low']:.2f} to {one['high']:.2f}" for one in row["regions"])
        several = "one of several" if len(row["regions"]) > 1 else "not identified"
        cells = {
            "mu_kpa": row["mu_pa"] / 1e3 if identified else None,
            "alpha": row["alpha"] if identified else None,
            "alpha_regions_95": regions.replace("-", "−"),
            "residual_percent": f"{100 * row['residual_sd_pa'] / size[row['specimen']]:.2g}",
            "alpha_verdict": "identified" if identified else several,
        }
        rows.append({**row, **cells})
    return [Table("material", rows, _COLUMNS)]


_STRESS_LABEL = "stress (kPa),\npositive in compression"


def draw(found: Run) -> dict[str, Drawing]:
    """Return curves with their residuals, and the profiles of alpha."""
    measure = found.run["measure"]
    panels = (
        Panel(f"{measure} {_STRESS_LABEL}", "fitted_pa", "measured_pa", scale=-1e-3, share=2.2),
        Panel("fitted minus\nmeasured (kPa)", "residual_pa", scale=1e-3, zero=True),
    )
    options = {"x": "stretch", "by": "specimen", "panels": panels, "falling": True}
    profiles = {"x": "alpha", "by": "specimen", "label": "α", "prior": PRIOR_LABEL}
    return {
        "curves": Drawing("curves", found.frames["curves"], options),
        "profiles": Drawing("profiles_by_series", found.frames["profiles"], profiles),
    }


def write_prior(found: Run, folder: Path) -> None:
    """Write the prior of a layer, if some specimen identifies alpha."""
    if found.run["prior"] is None:
        return
    head = (
        "# What a compression test determines of one layer. A fit or study takes it, here for layer 1, by\n"
        '#     priors = { 1 = "the/path/of/this/file/prior.toml" }\n'
    )
    note = TEXT.sentence("prior_note", describe(found))
    tables = {"schema": 1, "title": found.dataset_title, "note": note, "sha256": found.run["sha256"]}
    (folder / "prior.toml").write_text(head + dumps({**tables, **found.run["prior"]}), encoding="utf-8")


def material_to_json(found: Run) -> dict[str, Any]:
    """Return the result as JSON values."""
    summary = [*REPORT.summarize(found), *(one.what for one in read_warnings(found.run))]
    cells = (row.items() for row in to_records(found.frames["material"]))
    rows = [{name: value for name, value in row if value is not None} for row in cells]
    return {"name": found.name, "summary": summary, "specimens": rows, "prior": found.run["prior"]}


REPORT = StudyReport(
    TEXT, describe, tabulate, draw, write_files=write_prior, to_json=material_to_json, rate=rate
)
