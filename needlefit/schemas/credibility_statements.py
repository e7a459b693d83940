"""Statements on a model's credibility that only people can make."""

from needlefit.schemas.base import FileRecord


class CredibilityStatementsRecord(FileRecord):
    """A file for `needlefit credibility RUN --statements FILE`; what is left out stays an empty box."""

    question_of_interest: str = ""
    """The question that a decision has to answer."""
    context_of_use: str = ""
    """What the model is used for in that decision."""
    model_influence: str = ""
    """Weight of the model beside other evidence."""
    decision_consequence: str = ""
    """What a wrong decision would cause."""
    quality_assurance: str = ""
    """Statement on software quality assurance."""
    use_error: str = ""
    """Statement on errors of use."""
    relevance_of_quantities: str = ""
    """Statement on the relevance of the quantities of interest."""
    relevance_of_validation: str = ""
    """Statement on the relevance of the validation to the context of use."""
