"""Present a compression test as tables (estimates, curves, profiles) and as sentences."""

from math import exp
from typing import Any

import numpy as np
import pandas as pd

from needlefit.inference.material import MaterialEstimate, MaterialFoundation
from needlefit.inference.specimen_fit import ALPHA_RANGE, SpecimenFit
from needlefit.reporting.number_format import format_number


def tabulate_material(material: MaterialEstimate) -> list[dict[str, Any]]:
    """Return one row per specimen, and one for a further specimen if alpha is known."""
    rows = [_specimen_row(fit) for fit in material.fits]
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
"""Stands for a specimen in rows of `tabulate_profiles` that hold the ends of the prior of alpha."""


def tabulate_curves(material: MaterialEstimate) -> pd.DataFrame:
    """Return measured and fitted stress of all specimens, Pa, negative in compression."""
    return pd.concat([_specimen_curve(fit) for fit in material.fits], ignore_index=True)


def tabulate_profiles(material: MaterialEstimate) -> pd.DataFrame:
    """Return the profiles of alpha of all specimens, then the ends of the resulting prior, if there
    is one.
    """
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


FOUNDATION_MODULUS_NOTE = (
    "This mu is the shear modulus of the material. The model's is a foundation modulus: between the two lies "
    "how the needle moves the tissue around it, which no compression test holds"
)
FOUNDATION_OPTION = "--foundation FACTOR SPREAD"


def summarize_material(material: MaterialEstimate, foundation: MaterialFoundation | None) -> list[str]:
    """Return sentences: what the test determines, and what it does not."""
    open_ones = [describe_flat_region(fit) for fit in material.fits if not fit.identified]
    if not material.alpha_identified:
        return [*open_ones, "No specimen identifies alpha: no prior is written."]
    if foundation is None:
        return [
            *open_ones,
            _describe_known(material),
            f"{FOUNDATION_MODULUS_NOTE}, so a prior of it is written only with {FOUNDATION_OPTION}.",
        ]
    stated = f"{FOUNDATION_MODULUS_NOTE}: its prior rests on the stated factor of {foundation.factor:g}"
    return [
        *open_ones,
        _describe_known(material),
        f"{stated}, known within a factor of {foundation.spread:g}.",
    ]


def judge_alpha(fit: SpecimenFit) -> str:
    """Return one word: whether a specimen identifies alpha."""
    if fit.identified:
        return "identified"
    return "one of several" if len(fit.profile.regions) > 1 else "not identified"


def describe_flat_region(fit: SpecimenFit) -> str:
    """Return the range of alpha over which the fit to one specimen hardly changes."""
    low, high = fit.specimen.stretch.min(), fit.specimen.stretch.max()
    at = f"Specimen {fit.specimen.name} does not identify alpha at its stretches of {low:.3g} to {high:.3g}"
    flat = " and from ".join(_format_region(region) for region in fit.profile.regions)
    summary = f"{at}: its likelihood is flat from {flat} (95 %)."
    if len(fit.profile.regions) > 1:
        summary += (
            " Where one of the law's two powers outweighs the other, alpha and -2 alpha give the same curve;"
            " only small compressions tell them apart."
        )
    return summary


def describe_prior(material: MaterialEstimate) -> str:
    """Return a description of the prior: its sources, and what it does not include."""
    count = len(material.pooled)
    if count == 1:
        return f"one specimen, {material.pooled[0]}: the spread between specimens is not known and not in it"
    return f"a further specimen like these {count}: their spread is in it"


def _describe_known(material: MaterialEstimate) -> str:
    sd_log_mu, sd_alpha = material.sds
    mu = f"mu = {format_number(1e3 * exp(material.mean[0]))} kPa within {100 * sd_log_mu:.2g} %"
    summary = (
        f"A further specimen: alpha = {material.mean[1]:.3g} +- {sd_alpha:.2g}, {mu} (one standard deviation)"
    )
    if len(material.pooled) == 1:
        return f"{summary}, but the spread between specimens is not known from one: these are too sure."
    between = material.between[1, 1] ** 0.5
    return f"{summary}, from {len(material.pooled)} specimens; between them alpha spreads by {between:.2g}."


def _format_region(region: tuple[float, float]) -> str:
    low, high = (f"{end:.3g}" for end in region)
    low = "below " + low if region[0] <= ALPHA_RANGE[0] else low
    high = "above " + high if region[1] >= ALPHA_RANGE[1] else high
    return f"{low} to {high}"
