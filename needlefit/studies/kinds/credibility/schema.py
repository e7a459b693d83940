"""The study file of a credibility bundle, or the options of `needlefit credibility`."""

from typing import Literal

from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.credibility_statements import CredibilityStatementsRecord

NO_STATEMENTS = CredibilityStatementsRecord.model_validate({"schema": 1})


class CredibilityRecord(AnalysisRecord):
    """`kind = "credibility"`: the credibility evidence of a run in one document."""

    kind: Literal["credibility"]
    run: str
    """Folder of a run, or its name in `reports/`."""
    evidence: tuple[str, ...] = ()
    """Folders of other commands; without it, those that lie beside the run."""
    statements: CredibilityStatementsRecord = NO_STATEMENTS
    """Statements that only people can make."""
    statements_file: str = ""
    """File that they were read from."""
