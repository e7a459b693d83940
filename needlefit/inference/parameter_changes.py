"""Load a tissue model with what a fit states of it: priors, and parameters that are free or fixed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from needlefit.errors import ConfigError
from needlefit.inference.parameter_names import dimension, is_shape_parameter
from needlefit.inference.parameters import (
    Parameters,
    check_values,
    state_usual,
    state_usual_bounds,
    without_prior,
)
from needlefit.mechanics.laws import LAWS
from needlefit.project.input_files import to_json_values
from needlefit.project.toml import add_file_context, add_key_context, check, find_named, load
from needlefit.schemas.medium import (
    MAX_CUT_ANGLE_DEG,
    MIN_CUT_ANGLE_DEG,
    MaterialRecord,
    MediumRecord,
    ParameterRecord,
    spell_parameter,
)
from needlefit.schemas.study import FitRecord

#: bounds (Pa) of a modulus that is freed where no other one is free and untied
MODULUS_BOUNDS_PA = (1e2, 1e9)
#: bounds of other parameters that are freed (mm, degrees)
FREED_BOUNDS = {
    "bevel_mm": (1e-3, 0.5),
    "cut_angle_deg": (MIN_CUT_ANGLE_DEG, MAX_CUT_ANGLE_DEG),
    "guide_distance_mm": (1.0, 120.0),
}


def load_changed_medium(record: FitRecord) -> tuple[MediumRecord, Path]:
    """Return the medium that a fit names, with its priors and what it frees and fixes, and its file."""
    file = find_named("medium", record.medium)
    stated, materials = load(file, MediumRecord), read_priors(record)
    medium = set_priors(stated, materials)
    with add_file_context(file):
        Parameters.from_record(medium)  # faults of the medium itself, before those of the changes
    return change_parameters(medium, record.free, record.fix), file


def change_fit(
    record: FitRecord,
    medium: MediumRecord | None,
    free: Sequence[str],
    fix: Mapping[str, float],
    where: str,
) -> tuple[FitRecord, MediumRecord | None]:
    """Return a fit that also searches the parameters `free`, and holds those in `fix` (Pa, mm, degrees).

    They take the place of what the fit itself frees and fixes. A `medium` in memory, which takes the place of
    the file that the fit names, changes too. `where` is what messages name.

    Raises ConfigError if a name is in both, or as of `change_parameters`.
    """
    names = [spell_parameter(name) for name in free]
    values = {spell_parameter(name): value for name, value in fix.items()}
    changes: dict[str, Any] = {
        "free": [*(name for name in record.free if name not in values), *names],
        "fix": to_json_values({n: value for n, value in record.fix.items() if n not in names} | values),
    }
    if medium is not None:
        medium = change_parameters(medium, names, values)
    return check(record.model_dump(mode="json", by_alias=True) | changes, type(record), where), medium


def change_parameters(medium: MediumRecord, free: Sequence[str], fix: Mapping[str, float]) -> MediumRecord:
    """Return a checked tissue model with some parameters free that it fixes or ties, and some fixed.

    What is tied exactly to a fixed parameter is fixed with it; a tie with a spread stays.

    Parameters
    ----------
    free : sequence of str
        A shape parameter gets the law's usual bounds and prior, a modulus the bounds of the one that it is
        tied to, times the factor of the tie, else those that span all moduli that are free and not tied. All
        are widened to contain the value at which the parameter is fixed. Of one that is free with a prior of
        its own nothing changes: `search_freed` searches it. `alpha` stands for that of every layer.
    fix : mapping
        Values in Pa, mm or degrees. A prior of the parameter is left out.

    Raises
    ------
    ConfigError
        If a name is unknown, or is in both; what is to be freed is free; a value is outside the law's range.
    """
    if not (free or fix):
        return medium
    stated, table = Parameters.from_record(medium), state_usual_bounds(medium) | medium.parameters
    free, shape = name_layers(medium, free), LAWS[medium.law].shape_names
    known_names = [name for name in stated.names if not is_shape_parameter(name) or dimension(name) in shape]
    for key, names in (("free", free), ("fix", fix)):
        for name in (name for name in names if name not in known_names):
            raise ConfigError(
                f"the tissue model has no parameter `{name}`",
                expected=f"one of {', '.join(known_names)}",
                fix="use one of these names",
                key=key,
            )
    changed = {}
    for name in free:
        if name in fix:
            raise ConfigError(f"`{name}` is in `fix` too", fix="leave it out of one of them", key="free")
        bounds = table[name].bounds
        if name in stated.held:
            continue
        if bounds is not None:
            raise ConfigError(
                f"`{name}` is free already, within {bounds[0]:g} to {bounds[1]:g}",
                expected="a parameter that the tissue model fixes or ties",
                fix="leave it out; its bounds are in the tissue model",
                key="free",
            )
        changed[name] = _make_free(stated, name, medium.law)
    for name, value in fix.items():
        changed[name] = ParameterRecord(fixed=value)
        try:
            check_values(name, changed[name], medium.law)
        except ConfigError as error:  # which names the key of a tissue model
            error.key = error.key.replace("parameters", "fix", 1)
            raise
    return medium.model_copy(update={"parameters": medium.parameters | changed})


def name_layers(medium: MediumRecord, names: Sequence[str]) -> list[str]:
    """Return the names of parameters, "alpha" as those of all layers of which it is not tied."""
    table, layer_names = state_usual_bounds(medium) | medium.parameters, list[str]()
    for name in names:
        layers = [f"{name}{number}" for number in range(1, medium.layers + 1)]
        is_shape = name in LAWS[medium.law].shape_names
        layer_names += [layer for layer in layers if table[layer].tie is None] if is_shape else [name]
    return list(dict.fromkeys(layer_names))


def search_freed(parameters: Parameters, medium: MediumRecord, free: Sequence[str]) -> Parameters:
    """Return the parameters of a medium of which none in `free` is held."""
    freed = name_layers(medium, free)
    return parameters.holding([name for name in parameters.held if name not in freed])


def complete_published(
    name: str, published: Mapping[str, float], parameters: Parameters, medium: str
) -> dict[str, float]:
    """Return a set of the paper with what the medium of a name fixes; ConfigError if its layers differ."""
    complete = {**parameters.fixed, **published}
    if missing := [name for name in parameters.names if name not in complete]:
        raise ConfigError(
            f"the paper's set `{name}` has no {', '.join(missing)}, which medium `{medium}` needs",
            fix="name a set of the same layers, or leave paper_parameters out",
        )
    return {name: complete[name] for name in parameters.names}


def _make_free(parameters: Parameters, name: str, law: str) -> ParameterRecord:
    """Return a fixed or tied parameter once it is free, with its bounds (Pa, mm, degrees)."""
    exact = without_prior(parameters)  # all ties lead to a parameter that is not tied
    factor, source = exact.ties.get(name, (1.0, ""))
    prior = None
    if is_shape_parameter(name):
        usual = {parameter.name: state_usual(parameter) for parameter in LAWS[law].parameters}[
            dimension(name)
        ]
        assert usual.bounds is not None
        (low, high), prior = usual.bounds, usual.prior
    elif source in exact.bounds:
        low, high = (factor * bound for bound in exact.bounds[source])
    elif dimension(name) == "modulus":
        moduli = [bounds for other, bounds in exact.bounds.items() if dimension(other) == "modulus"]
        low = min((bounds[0] for bounds in moduli), default=MODULUS_BOUNDS_PA[0])
        high = max((bounds[1] for bounds in moduli), default=MODULUS_BOUNDS_PA[1])
    else:
        low, high = FREED_BOUNDS[name]
    value = exact.fixed.get(name)
    # a bevel of 0 steers nowhere, and has no logarithm
    if value is not None and (value != 0 or is_shape_parameter(name)):
        low, high = min(low, value), max(high, value)
    return ParameterRecord(bounds=(low, high), prior=prior)


def read_priors(record: FitRecord) -> dict[str, MaterialRecord]:
    """Read the priors of layers that a fit names."""
    return {layer: load(Path(path), MaterialRecord) for layer, path in record.priors.items()}


def set_priors(medium: MediumRecord, priors: Mapping[str, MaterialRecord]) -> MediumRecord:
    """Return the medium, its layers with these priors."""
    for layer, material in priors.items():
        with add_key_context(f"priors.{layer}"):
            medium = set_material_prior(medium, layer, material)
    return medium


#: number of standard deviations within which a fixed alpha that a test identifies becomes free
ALPHA_REACH_SD = 4.0
TEST_LAW = "ogden"  #: law that alpha and mu of a compression test belong to


def set_material_prior(medium: MediumRecord, layer: str, material: MaterialRecord) -> MediumRecord:
    """Return the medium with the prior of a compression test on one layer.

    An alpha that the medium fixes, or of which it states a prior, becomes free within `ALPHA_REACH_SD`
    standard deviations of the mean of the test's prior.

    Raises ConfigError if there is no such layer, the medium's law is another one, or the layer's parameter is
    tied or fixed.
    """
    if layer not in {str(number) for number in range(1, medium.layers + 1)}:
        raise ConfigError(f"there is no layer `{layer}`", expected=f"a number from 1 to {medium.layers}")
    if medium.law != TEST_LAW:
        raise ConfigError(
            f"the medium's law is `{medium.law}`", expected=f"`{TEST_LAW}`: the prior is of its alpha"
        )
    table = state_usual_bounds(medium) | medium.parameters
    for name, stated in ((f"mu{layer}_pa", material.mu_pa), (f"alpha{layer}", material.alpha)):
        if stated is None or name not in table:
            continue
        bounds, tie = table[name].bounds, table[name].tie
        open_ended = tie is None and (bounds is None or table[name].prior is not None)
        if open_ended and stated.mean is not None and stated.sd is not None:
            bounds = (stated.mean - ALPHA_REACH_SD * stated.sd, stated.mean + ALPHA_REACH_SD * stated.sd)
        if bounds is None:
            fix = "give it bounds" + (", or the prior to the layer that it is tied to" if tie else "")
            state = "tied" if tie else "fixed"
            raise ConfigError(f"a prior is stated for {name}, which is {state}", fix=fix)
        table[name] = ParameterRecord(bounds=bounds, prior=stated)
    return medium.model_copy(update={"parameters": table})
