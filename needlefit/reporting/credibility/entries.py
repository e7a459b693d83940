"""Every factor with what was found of it: the whole bundle, before it is set."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from needlefit.reporting.credibility import assessed, compared, modelled, verified
from needlefit.reporting.credibility.case import Case
from needlefit.reporting.credibility.factors import FACTORS, Factor
from needlefit.reporting.credibility.told import Finding, Told


@dataclass(frozen=True)
class Entry:
    """One factor and what is told of it."""

    factor: Factor
    told: Told

    @property
    def gaps(self) -> tuple[str, ...]:
        """What stands in its empty boxes."""
        found = bool(self.told.findings)
        if self.factor.by_people:
            stated = any(one.command == "" for one in self.told.findings)
            return self.told.left if stated else (self.factor.fix, *self.told.left)
        return self.told.left if found else (f"Nothing found. {self.factor.fix}", *self.told.left)


_FINDERS: Mapping[str, Callable[[Case], Told]] = MappingProxyType(
    {
        "quality_assurance": verified.quality_assurance,
        "code_verification": verified.code_verification,
        "discretisation": verified.discretisation,
        "solver": verified.solver,
        "use_error": verified.use_error,
        "form": modelled.form,
        "sensitivities": modelled.sensitivities,
        "uncertainties": modelled.uncertainties,
        "samples": compared.samples,
        "samples_range": compared.samples_range,
        "samples_measured": compared.samples_measured,
        "samples_uncertainty": compared.samples_uncertainty,
        "conditions": compared.conditions,
        "conditions_range": compared.conditions_range,
        "conditions_measured": compared.conditions_measured,
        "conditions_uncertainty": compared.conditions_uncertainty,
        "inputs_alike": assessed.inputs_alike,
        "outputs": assessed.outputs,
        "outputs_alike": assessed.outputs_alike,
        "rigour": assessed.rigour,
        "agreement": assessed.agreement,
        "relevance_of_validation": compared.within,
    }
)


def entries(case: Case) -> list[Entry]:
    """Return every factor, in the order of the standard."""
    return [Entry(factor, _told(factor, case)) for factor in FACTORS]


def _told(factor: Factor, case: Case) -> Told:
    """Return what people state of a factor, then what was found in files."""
    find = _FINDERS.get(factor.key)
    told = find(case) if find else Told()
    stated = getattr(case.about, factor.key, "").strip()
    if not stated:
        return told
    return replace(told, findings=(Finding(stated, case.stated_in, ""), *told.findings))
