"""Free and fix parameters of a tissue model by name, in place of what its file says of them."""

import difflib
from collections.abc import Mapping, Sequence

from needlefit.errors import ConfigError
from needlefit.inference.parameters import (
    HYPERPARAMETERS,
    Parameters,
    alpha_of,
    check_values,
    dimension,
    is_shape_parameter,
    state_usual_bounds,
    without_prior,
)
from needlefit.mechanics.laws import LAWS
from needlefit.project.toml import renamed_keys
from needlefit.schemas.medium import (
    MAX_CUT_ANGLE_DEG,
    MIN_CUT_ANGLE_DEG,
    MediumRecord,
    ParameterRecord,
)

#: of a modulus that is freed where no other one is free and untied
MODULUS_BOUNDS_PA = (1e2, 1e9)
#: of other parameters that are freed
FREED_BOUNDS = {
    "bevel_mm": (1e-3, 0.5),
    "cut_angle_deg": (MIN_CUT_ANGLE_DEG, MAX_CUT_ANGLE_DEG),
    "guide_distance_mm": (1.0, 120.0),
}


def change_parameters(medium: MediumRecord, free: Sequence[str], fix: Mapping[str, float]) -> MediumRecord:
    """Return a checked tissue model with some parameters free that it fixes or ties, and some fixed.

    What is tied exactly to a fixed parameter is fixed with it; a tie with a spread stays.

    Parameters
    ----------
    free : sequence of str
        They get the bounds of `find_freed_bounds`.
    fix : mapping
        Values in Pa, mm or degrees. A prior of the parameter is left out.

    Raises
    ------
    ConfigError
        If a name is unknown, or is in both; what is to be freed is free; a value is outside the law's range,
        or of a parameter whose prior is correlated with that of another one.
    """
    if not (free or fix):
        return medium
    stated, table = Parameters.from_record(medium), state_usual_bounds(medium) | medium.parameters
    shape = LAWS[medium.law].shape_names
    known = [name for name in stated.names if not is_shape_parameter(name) or dimension(name) in shape]
    for key, names in (("free", free), ("fix", fix)):
        for name in names:
            _require_parameter(name, known, key)
    changed = {}
    for name in free:
        if name in fix:
            raise ConfigError(f"`{name}` is in `fix` too", key="free", fix="leave it out of one of them")
        bounds = table[name].bounds
        if bounds is not None:
            raise ConfigError(
                f"`{name}` is free already, within {bounds[0]:g} to {bounds[1]:g}",
                key="free",
                expected="a parameter that the tissue model fixes or ties",
                fix="leave it out; its bounds are in the tissue model",
            )
        changed[name] = ParameterRecord(bounds=find_freed_bounds(stated, name, medium.law))
    for name, value in fix.items():
        changed[name] = ParameterRecord(fixed=value)
        with renamed_keys({"parameters": "fix"}):
            check_values(name, changed[name], medium.law)
    parameters = medium.parameters | changed
    _require_priors(medium, parameters)
    return medium.model_copy(update={"parameters": parameters})


def find_freed_bounds(parameters: Parameters, name: str, law: str) -> tuple[float, float]:
    """Return the bounds (Pa, mm, degrees) within which a fixed or tied parameter is searched once it is free.

    Of a shape parameter they are the law's usual ones. Of a modulus they are those of the modulus that it is
    tied to, times the factor of the tie; else they span those of all moduli that are free and not tied. All
    are widened to contain the value at which the parameter is fixed.
    """
    exact = without_prior(parameters)  # all ties lead to a parameter that is not tied
    factor, source = exact.ties.get(name, (1.0, ""))
    if is_shape_parameter(name):
        usual = {one.name: one.usual for one in LAWS[law].parameters}
        low, high = usual[dimension(name)]
    elif source in exact.bounds:
        low, high = (factor * bound for bound in exact.bounds[source])
    elif dimension(name) == "modulus":
        moduli = [bounds for other, bounds in exact.bounds.items() if dimension(other) == "modulus"]
        low = min((bounds[0] for bounds in moduli), default=MODULUS_BOUNDS_PA[0])
        high = max((bounds[1] for bounds in moduli), default=MODULUS_BOUNDS_PA[1])
    else:
        low, high = FREED_BOUNDS[name]
    at = exact.fixed.get(name)
    # a bevel of 0 steers nowhere, and has no logarithm
    if at is None or (at == 0 and not is_shape_parameter(name)):
        return low, high
    return min(low, at), max(high, at)


def _require_parameter(name: str, known: Sequence[str], key: str) -> None:
    if name in HYPERPARAMETERS:
        raise ConfigError(
            f"`{name}` belongs to the likelihood, not to the tissue model",
            key=key,
            expected=f"one of {', '.join(known)}",
            fix=f"set `{name}` in [likelihood] of the recipe",
        )
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
        raise ConfigError(
            f"the tissue model has no parameter `{name}`",
            key=key,
            expected=f"one of {', '.join(known)}",
            fix=f"write `{near[0]}`" if near else "use one of these names",
        )


def _require_priors(medium: MediumRecord, changed: Mapping[str, ParameterRecord]) -> None:
    """Refuse to fix a parameter whose prior is correlated with that of another one, which keeps its own."""
    for name, record in medium.parameters.items():
        if record.prior is None or not record.prior.correlation:
            continue
        pair = {name, alpha_of(name)}
        fixed = [one for one in pair if changed[one].prior is None]
        if len(fixed) == 1:
            raise ConfigError(
                f"the prior of `{fixed[0]}` is correlated with that of `{(pair - {*fixed}).pop()}`",
                key=f"fix.{fixed[0]}",
                fix="fix both, or leave out the prior of this layer",
            )
