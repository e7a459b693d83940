"""Fit the Ogden law to every specimen of a compression test, and pool them to the prior of a layer."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.datasets.compression import read_compression
from needlefit.inference.material import (
    MaterialEstimate,
    MaterialFoundation,
    fit_material,
    make_material_prior,
)
from needlefit.inference.specimen_fit import ALPHA_RANGE, SpecimenFit
from needlefit.project.result_warnings import ResultWarning, warnings_entry
from needlefit.studies.job import Settings
from needlefit.studies.kinds.material.schema import CompressionRecord
from needlefit.studies.provenance import package_versions
from needlefit.studies.run import Run

_PACKAGES = ("numpy", "scipy")

FURTHER_SPECIMEN = "(a further one)"
"""Stands for a specimen in the last row of the frame "material", if alpha is known."""


def run(name: str, record: CompressionRecord, settings: Settings) -> Run:
    """Fit the test in `record.file`.

    Raises
    ------
    ConfigError, DataError
        If the file, or the stated foundation factor, is missing or wrong.
    """
    foundation = None if record.foundation is None else MaterialFoundation(*record.foundation)
    test = read_compression(Path(record.file), record.stress)
    material = fit_material(test)
    named = {"file": test.path.name, "title": record.title or f"Compression test {test.path.name}"}
    stored = record.model_copy(update=named)
    return Run(
        kind=record.kind,
        name=name,
        record=stored,
        origin="measured",
        dataset_title=test.path.name,
        frames={
            "material": pd.DataFrame(_tabulate_material(material)),
            "regions": pd.DataFrame(
                [
                    (fit.specimen.name, low, high)
                    for fit in material.fits
                    for low, high in fit.profile.regions
                ],
                columns=["specimen", "low", "high"],
            ),
            "curves": _tabulate_curves(material),
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
            "prior": _tabulate_prior(material, foundation) if material.alpha_identified else None,
            **warnings_entry(ResultWarning("compression_test", what) for what in test.warnings),
        },
        timing={},
    )


def _tabulate_prior(
    material: MaterialEstimate, foundation: MaterialFoundation | None
) -> Mapping[str, Mapping[str, Any]]:
    alpha, mu = make_material_prior(material, foundation)
    stated = {"alpha": alpha} if mu is None else {"alpha": alpha, "mu_pa": mu}
    return {name: one.model_dump(exclude_defaults=True) for name, one in stated.items()}


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


PRIOR_LABEL = "(prior, ± one sd)"
"""Stands for a specimen in rows of the frame "profiles" that hold the ends of the prior of alpha."""


def _tabulate_curves(material: MaterialEstimate) -> pd.DataFrame:
    """Return measured and fitted stress of all specimens, Pa, negative in compression."""
    return pd.concat([_specimen_curve(fit) for fit in material.fits], ignore_index=True)


def _tabulate_profiles(material: MaterialEstimate) -> pd.DataFrame:
    """Return the profiles of alpha of all specimens, then the ends of the prior, if there is one."""
    found = [_specimen_profile(fit) for fit in material.fits]
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


def _specimen_profile(fit: SpecimenFit) -> pd.DataFrame:
    """Return the profile of alpha, 0 at its peak; log likelihoods of what no positive mu fits are missing."""
    ratio = fit.profile.ratio
    return pd.DataFrame(
        {
            "specimen": fit.specimen.name,
            "alpha": fit.profile.alpha,
            "mu_pa": 1e6 * fit.profile.mu,
            "log_likelihood": -0.5 * fit.effective_points * np.log(ratio),
            "in_95_region": ratio <= fit.profile.limit,
        }
    ).replace({np.inf: np.nan, -np.inf: np.nan})
