"""What a compression test tells of alpha and mu, in sentences: what it cannot tell first."""

from math import exp

from needlefit.inference.material import MaterialEstimate, MaterialFoundation
from needlefit.inference.specimen_fit import ALPHA_RANGE, SpecimenFit
from needlefit.reporting.numbers import number

OTHER_MU = (
    "This mu is the shear modulus of the material. The model's is a foundation modulus: between the two lies "
    "how the needle moves the tissue around it, which no compression test holds"
)
OPTION = "--foundation FACTOR SPREAD"


def summary(material: MaterialEstimate, foundation: MaterialFoundation | None) -> list[str]:
    """Return what is known, and what is not, a sentence each."""
    open_ones = [not_identified(fit) for fit in material.fits if not fit.identified]
    if not material.alpha_identified:
        return [*open_ones, "No specimen identifies alpha: no prior is written."]
    if foundation is None:
        return [*open_ones, _known(material), f"{OTHER_MU}, so a prior of it is written only with {OPTION}."]
    stated = f"{OTHER_MU}: its prior rests on the stated factor of {foundation.factor:g}"
    return [*open_ones, _known(material), f"{stated}, known within a factor of {foundation.spread:g}."]


def verdict(fit: SpecimenFit) -> str:
    """Return in a word whether a specimen identifies alpha."""
    if fit.identified:
        return "identified"
    return "one of several" if len(fit.profile.regions) > 1 else "not identified"


def not_identified(fit: SpecimenFit) -> str:
    """Return over which alphas the test of one specimen is flat."""
    low, high = fit.specimen.stretch.min(), fit.specimen.stretch.max()
    at = f"Specimen {fit.specimen.name} does not identify alpha at its stretches of {low:.3g} to {high:.3g}"
    flat = " and from ".join(_range(region) for region in fit.profile.regions)
    said = f"{at}: its likelihood is flat from {flat} (95 %)."
    if len(fit.profile.regions) > 1:
        said += (
            " Where one of the law's two powers outweighs the other, alpha and -2 alpha give the same curve;"
            " only small compressions tell them apart."
        )
    return said


def prior_note(material: MaterialEstimate) -> str:
    """Return what the prior is of, and what is not in it."""
    count = len(material.pooled)
    if count == 1:
        return f"one specimen, {material.pooled[0]}: the spread between specimens is not known and not in it"
    return f"a further specimen like these {count}: their spread is in it"


def _known(material: MaterialEstimate) -> str:
    sd_log_mu, sd_alpha = material.sds
    mu = f"mu = {number(1e3 * exp(material.mean[0]))} kPa within {100 * sd_log_mu:.2g} %"
    said = (
        f"A further specimen: alpha = {material.mean[1]:.3g} +- {sd_alpha:.2g}, {mu} (one standard deviation)"
    )
    if len(material.pooled) == 1:
        return f"{said}, but the spread between specimens is not known from one: these are too sure."
    between = material.between[1, 1] ** 0.5
    return f"{said}, from {len(material.pooled)} specimens; between them alpha spreads by {between:.2g}."


def _range(region: tuple[float, float]) -> str:
    low, high = (f"{end:.3g}" for end in region)
    low = "below " + low if region[0] <= ALPHA_RANGE[0] else low
    high = "above " + high if region[1] >= ALPHA_RANGE[1] else high
    return f"{low} to {high}"
