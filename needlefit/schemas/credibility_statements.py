"""Statements on a model's credibility that only people can make."""

from needlefit.schemas.base import FileRecord


class CredibilityStatementsRecord(FileRecord):
    """A TOML file for `needlefit credibility RUN --statements FILE`; what is left out stays an empty box.

    `question_of_interest` is what a decision has to answer, `context_of_use` what the model is used for in
    that, `model_influence` how much it weighs beside other evidence, `decision_consequence` what a wrong
    decision would do. The others are statements on single factors.
    """

    question_of_interest: str = ""
    context_of_use: str = ""
    model_influence: str = ""
    decision_consequence: str = ""
    quality_assurance: str = ""
    use_error: str = ""
    relevance_of_quantities: str = ""
    relevance_of_validation: str = ""
