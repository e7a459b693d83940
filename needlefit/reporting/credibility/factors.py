"""The credibility factors of ASME V&V 40-2018 in its order, each with what would fill its gap.

Their names and order are those that public accounts of the standard give: FDA, Assessing the Credibility of
Computational Modeling and Simulation in Medical Device Submissions (guidance, 17 November 2023), and
T. M. Morrison et al., ASAIO Journal 65 (2019) 349. What a factor asks is said in our own words. The standard
has gradations of rigour for each; which one is reached is not judged here.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Factor:
    """One factor, or one aspect of a factor.

    Attributes
    ----------
    key : str
        Within this room, and of the statement that people give of it.
    part : str
        The section it stands in.
    name : str
    asks : str
        What it asks.
    fix : str
        What would fill it where nothing was found.
    by_people : bool
        Whether only a statement of people fills it, whatever was found.
    """

    key: str
    part: str
    name: str
    asks: str
    fix: str
    by_people: bool = False


def _told_by(whom: str, key: str, part: str, name: str, asks: str) -> Factor:
    """Return a factor that no program can tell."""
    fix = f"Not for a program to tell: to be filled in by {whom} (--statements FILE, key {key})."
    return Factor(key, part, name, asks, fix, by_people=True)


_USERS = "those who use the model"
_FRAME, _CODE, _CALCULATION = "Question and risk", "Verification: code", "Verification: calculation"
_MODEL, _COMPARATOR = "Validation: computational model", "Validation: comparator"
_ASSESSMENT, _APPLICABILITY = "Validation: assessment", "Applicability"

_VERIFY = "needlefit verify would give it."
_STUDY = "needlefit validate would give it, of a study with insertions held out."
_SENSITIVITY = "needlefit validate sensitivity and needlefit identify would give it."
_CALIBRATE = "needlefit calibrate and needlefit validate would give it."
_DATASET = "The run’s files do not hold it; what is stated of it stands with the dataset."

FACTORS = (
    _told_by(
        _USERS, "question_of_interest", _FRAME, "Question of interest", "What has a decision to answer?"
    ),
    _told_by(
        _USERS, "context_of_use", _FRAME, "Context of use", "What is the model used for in answering it?"
    ),
    _told_by(
        _USERS,
        "model_influence",
        _FRAME,
        "Model risk: influence",
        "How much does the model weigh beside other evidence?",
    ),
    _told_by(
        _USERS,
        "decision_consequence",
        _FRAME,
        "Model risk: decision consequence",
        "What would a wrong decision do?",
    ),
    _told_by(
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
        _VERIFY,
    ),
    Factor(
        "discretisation",
        _CALCULATION,
        "Discretisation error",
        "What does the mesh leave in the results?",
        _VERIFY,
    ),
    Factor(
        "solver",
        _CALCULATION,
        "Numerical solver error",
        "What do tolerances, searches and failed solves leave in the results?",
        _VERIFY,
    ),
    _told_by(
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
        _SENSITIVITY,
    ),
    Factor(
        "uncertainties",
        _MODEL,
        "Model inputs: quantification of uncertainties",
        "How well are they known, is that propagated, and are these uncertainties right?",
        _CALIBRATE,
    ),
    Factor("samples", _COMPARATOR, "Test samples: quantity", "How many specimens were tested?", _STUDY),
    Factor(
        "samples_range",
        _COMPARATOR,
        "Test samples: range of characteristics",
        "What range of media and layers do they cover?",
        _STUDY,
    ),
    Factor(
        "samples_measured",
        _COMPARATOR,
        "Test samples: measurements",
        "What of the specimens was measured?",
        _DATASET,
    ),
    Factor(
        "samples_uncertainty",
        _COMPARATOR,
        "Test samples: uncertainty of measurements",
        "How well was it measured?",
        _DATASET,
    ),
    Factor(
        "conditions",
        _COMPARATOR,
        "Test conditions: quantity",
        "Under how many conditions were they tested?",
        _STUDY,
    ),
    Factor(
        "conditions_range",
        _COMPARATOR,
        "Test conditions: range of conditions",
        "What range of depths and deflections do they cover?",
        _STUDY,
    ),
    Factor(
        "conditions_measured",
        _COMPARATOR,
        "Test conditions: measurements",
        "What of the conditions was measured?",
        _DATASET,
    ),
    Factor(
        "conditions_uncertainty",
        _COMPARATOR,
        "Test conditions: uncertainty of measurements",
        "How well was it measured?",
        _DATASET,
    ),
    Factor(
        "inputs_alike",
        _ASSESSMENT,
        "Equivalency of input parameters",
        "Was the model given what the experiment had?",
        _STUDY,
    ),
    Factor("outputs", _ASSESSMENT, "Output comparison: quantity", "How many outputs were compared?", _STUDY),
    Factor(
        "outputs_alike",
        _ASSESSMENT,
        "Output comparison: equivalency of output parameters",
        "Are the outputs compared the same quantities?",
        _STUDY,
    ),
    Factor(
        "rigour",
        _ASSESSMENT,
        "Output comparison: rigour",
        "How was compared, and with which uncertainties?",
        _STUDY,
    ),
    Factor("agreement", _ASSESSMENT, "Output comparison: agreement", "How well do they agree?", _STUDY),
    _told_by(
        _USERS,
        "relevance_of_quantities",
        _APPLICABILITY,
        "Relevance of the quantities of interest",
        "Do the outputs compared speak to the question?",
    ),
    _told_by(
        _USERS,
        "relevance_of_validation",
        _APPLICABILITY,
        "Relevance of the validation activities to the context of use",
        "Do samples and conditions compared speak to the use?",
    ),
)
