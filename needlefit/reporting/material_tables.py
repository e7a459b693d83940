"""A compression test as tables for machines: estimates, curves, profiles."""

from typing import Any

import numpy as np
import pandas as pd

from needlefit.inference.material import MaterialEstimate
from needlefit.inference.specimen_fit import SpecimenFit


def table(material: MaterialEstimate) -> list[dict[str, Any]]:
    """Return one row per specimen for machines, and one for a further specimen if alpha is known."""
    rows = [_row(fit) for fit in material.fits]
    if material.alpha_identified:
        sd_log_mu, sd_alpha = material.sds
        log_mu, alpha = material.mean.tolist()
        rows.append(
            {
                "specimen": "(a further one)",
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


def _row(fit: SpecimenFit) -> dict[str, Any]:
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


PRIOR = "(prior, ± one sd)"
"""Stands for a specimen in rows of `profiles` that hold the ends of the prior of alpha."""


def curves(material: MaterialEstimate) -> pd.DataFrame:
    """Return measured and fitted stress of all specimens, Pa, negative in compression."""
    return pd.concat([_curve(fit) for fit in material.fits], ignore_index=True)


def profiles(material: MaterialEstimate) -> pd.DataFrame:
    """Return the profiles of alpha of all specimens, then the ends of the prior that follows, if any does."""
    found = [_profile(fit) for fit in material.fits]
    if material.alpha_identified:
        ends = [float(material.mean[1]) + side * material.sds[1] for side in (-1.0, 1.0)]
        found.append(pd.DataFrame({"specimen": PRIOR, "alpha": ends, "in_95_region": False}))
    return pd.concat(found, ignore_index=True)


def _curve(fit: SpecimenFit) -> pd.DataFrame:
    """Return measured and fitted stress, Pa, negative in compression."""
    measured = 1e6 * fit.specimen.stress
    return pd.DataFrame(
        {
            "specimen": fit.specimen.name,
            "stretch": fit.specimen.stretch,
            "measured_pa": measured,
            "fitted_pa": measured + 1e6 * fit.residuals,
            "residual_pa": 1e6 * fit.residuals,
        }
    )


def _profile(fit: SpecimenFit) -> pd.DataFrame:
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
