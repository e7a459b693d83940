"""The credibility factors of ASME V&V 40-2018 in their order, each with the evidence that would close its
gap.

Their names and order are those that public accounts of the standard give: FDA, Assessing the Credibility of
Computational Modeling and Simulation in Medical Device Submissions (guidance, 17 November 2023), and
T. M. Morrison et al., ASAIO Journal 65 (2019) 349. What a factor asks is said in our own words. The standard
has gradations of rigour for each; which one is reached is not judged here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from needlefit.studies.kinds.credibility import model_findings, validation_findings, verification_findings
from needlefit.studies.kinds.credibility.case import CredibilityCase, FactorFindings, Finding


@dataclass(frozen=True)
class Factor:
    """One factor, or one aspect of a factor.

    Attributes
    ----------
    key : str
        Within this package, and of the statement that people give of it.
    part : str
        The section it stands in.
    name : str
    question : str
        The question of the factor.
    fix : str
        What would fill it where nothing was found.
    needs_statement : bool
        Whether only a statement of people fills it, whatever was found.
    """

    key: str
    part: str
    name: str
    question: str
    fix: str
    needs_statement: bool = False


def _stated_factor(whom: str, key: str, part: str, name: str, question: str) -> Factor:
    """Return a factor that only people can assess."""
    fix = f"A program cannot decide this: to be filled in by {whom} (--statements FILE, key {key})."
    return Factor(key, part, name, question, fix, needs_statement=True)


_USERS = "those who use the model"
_FRAME, _CODE, _CALCULATION = "Question and risk", "Verification: code", "Verification: calculation"
_MODEL, _COMPARATOR = "Validation: computational model", "Validation: comparator"
_ASSESSMENT, _APPLICABILITY = "Validation: assessment", "Applicability"

_FIX_VERIFY = "needlefit verify would give it."
_FIX_VALIDATE = "needlefit validate would give it, of a study with insertions held out."
_FIX_SENSITIVITY = "needlefit validate sensitivity and needlefit identify would give it."
_FIX_CALIBRATE = "needlefit calibrate and needlefit validate would give it."
_FIX_DATASET = "The run’s files do not hold it; what is stated of it stands with the dataset."

FACTORS = (
    _stated_factor(
        _USERS, "question_of_interest", _FRAME, "Question of interest", "What has a decision to answer?"
    ),
    _stated_factor(
        _USERS, "context_of_use", _FRAME, "Context of use", "What is the model used for in answering it?"
    ),
    _stated_factor(
        _USERS,
        "model_influence",
        _FRAME,
        "Model risk: influence",
        "How much does the model weigh beside other evidence?",
    ),
    _stated_factor(
        _USERS,
        "decision_consequence",
        _FRAME,
        "Model risk: decision consequence",
        "What would a wrong decision do?",
    ),
    _stated_factor(
        "those who install and maintain it",
        "quality_assurance",
        _CODE,
        "Software quality assurance",
        "Does the software function as specified, and repeatably, on this machine?",
    ),
    Factor(
        "code_verification",
        _CODE,
        "Numerical code verification",
        "Are the equations solved that are stated, at the orders that theory promises?",
        _FIX_VERIFY,
    ),
    Factor(
        "discretisation",
        _CALCULATION,
        "Discretisation error",
        "What does the mesh leave in the results?",
        _FIX_VERIFY,
    ),
    Factor(
        "solver",
        _CALCULATION,
        "Numerical solver error",
        "What do tolerances, searches and failed solves leave in the results?",
        _FIX_VERIFY,
    ),
    _stated_factor(
        "those who ran it, and somebody else who ran it again",
        "use_error",
        _CALCULATION,
        "Use error",
        "Were the right inputs given, and the outputs read right?",
    ),
    Factor(
        "form",
        _MODEL,
        "Model form",
        "What do the assumptions of the model matter: its law, its decided rules, its mechanics at all?",
        "needlefit validate sensitivity; needlefit validate STUDY.",
    ),
    Factor(
        "sensitivities",
        _MODEL,
        "Model inputs: quantification of sensitivities",
        "What do parameters and properties given to the model matter?",
        _FIX_SENSITIVITY,
    ),
    Factor(
        "uncertainties",
        _MODEL,
        "Model inputs: quantification of uncertainties",
        "How well are they known, is that propagated, and are these uncertainties right?",
        _FIX_CALIBRATE,
    ),
    Factor(
        "samples", _COMPARATOR, "Test samples: quantity", "How many specimens were tested?", _FIX_VALIDATE
    ),
    Factor(
        "samples_range",
        _COMPARATOR,
        "Test samples: range of characteristics",
        "What range of media and layers do they cover?",
        _FIX_VALIDATE,
    ),
    Factor(
        "samples_measured",
        _COMPARATOR,
        "Test samples: measurements",
        "What of the specimens was measured?",
        _FIX_DATASET,
    ),
    Factor(
        "samples_uncertainty",
        _COMPARATOR,
        "Test samples: uncertainty of measurements",
        "How well was it measured?",
        _FIX_DATASET,
    ),
    Factor(
        "conditions",
        _COMPARATOR,
        "Test conditions: quantity",
        "Under how many conditions were they tested?",
        _FIX_VALIDATE,
    ),
    Factor(
        "conditions_range",
        _COMPARATOR,
        "Test conditions: range of conditions",
        "What range of depths and deflections do they cover?",
        _FIX_VALIDATE,
    ),
    Factor(
        "conditions_measured",
        _COMPARATOR,
        "Test conditions: measurements",
        "What of the conditions was measured?",
        _FIX_DATASET,
    ),
    Factor(
        "conditions_uncertainty",
        _COMPARATOR,
        "Test conditions: uncertainty of measurements",
        "How well was it measured?",
        _FIX_DATASET,
    ),
    Factor(
        "inputs_alike",
        _ASSESSMENT,
        "Equivalency of input parameters",
        "Was the model given what the experiment had?",
        _FIX_VALIDATE,
    ),
    Factor(
        "outputs",
        _ASSESSMENT,
        "Output comparison: quantity",
        "How many outputs were compared?",
        _FIX_VALIDATE,
    ),
    Factor(
        "outputs_alike",
        _ASSESSMENT,
        "Output comparison: equivalency of output parameters",
        "Are the outputs compared the same quantities?",
        _FIX_VALIDATE,
    ),
    Factor(
        "rigour",
        _ASSESSMENT,
        "Output comparison: rigour",
        "How was compared, and with which uncertainties?",
        _FIX_VALIDATE,
    ),
    Factor(
        "agreement", _ASSESSMENT, "Output comparison: agreement", "How well do they agree?", _FIX_VALIDATE
    ),
    _stated_factor(
        _USERS,
        "relevance_of_quantities",
        _APPLICABILITY,
        "Relevance of the quantities of interest",
        "Do the outputs compared speak to the question?",
    ),
    _stated_factor(
        _USERS,
        "relevance_of_validation",
        _APPLICABILITY,
        "Relevance of the validation activities to the context of use",
        "Do samples and conditions compared speak to the use?",
    ),
)


@dataclass(frozen=True)
class FactorEntry:
    """One factor with its findings."""

    factor: Factor
    content: FactorFindings

    @property
    def gaps(self) -> tuple[str, ...]:
        """The gaps of the factor."""
        found = bool(self.content.findings)
        if self.factor.needs_statement:
            stated = any(one.command == "" for one in self.content.findings)
            return self.content.gaps if stated else (self.factor.fix, *self.content.gaps)
        return self.content.gaps if found else (f"Nothing found. {self.factor.fix}", *self.content.gaps)


_FINDERS: Mapping[str, Callable[[CredibilityCase], FactorFindings]] = MappingProxyType(
    {
        "quality_assurance": verification_findings.find_quality_assurance,
        "code_verification": verification_findings.find_code_verification,
        "discretisation": verification_findings.find_discretisation,
        "solver": verification_findings.find_solver,
        "use_error": verification_findings.find_use_error,
        "form": model_findings.find_form,
        "sensitivities": model_findings.find_sensitivities,
        "uncertainties": model_findings.find_uncertainties,
        "samples": validation_findings.find_samples,
        "samples_range": validation_findings.find_samples_range,
        "samples_measured": validation_findings.find_sample_measurements,
        "samples_uncertainty": validation_findings.find_sample_uncertainty,
        "conditions": validation_findings.find_conditions,
        "conditions_range": validation_findings.find_conditions_range,
        "conditions_measured": validation_findings.find_condition_measurements,
        "conditions_uncertainty": validation_findings.find_condition_uncertainty,
        "inputs_alike": validation_findings.find_equal_inputs,
        "outputs": validation_findings.find_outputs,
        "outputs_alike": validation_findings.find_equal_outputs,
        "rigour": validation_findings.find_rigour,
        "agreement": validation_findings.find_agreement,
        "relevance_of_validation": validation_findings.find_tested_range,
    }
)


def collect_entries(case: CredibilityCase) -> list[FactorEntry]:
    """Return every factor with its findings, in the order of the standard."""
    return [FactorEntry(factor, _collect_findings(factor, case)) for factor in FACTORS]


def _collect_findings(factor: Factor, case: CredibilityCase) -> FactorFindings:
    """Return what people state of a factor, then what was found in files."""
    find = _FINDERS.get(factor.key)
    content = find(case) if find else FactorFindings()
    stated = getattr(case.statements, factor.key, "").strip()
    if not stated:
        return content
    return replace(content, findings=(Finding(stated, case.statements_file, ""), *content.findings))
