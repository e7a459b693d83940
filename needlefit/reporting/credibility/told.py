"""What is told of one factor: findings, each with the file it stands in, and what is left open."""

from dataclasses import dataclass
from pathlib import Path

from needlefit.reporting.display import Display


@dataclass(frozen=True)
class Finding:
    """One thing found.

    Attributes
    ----------
    words : str
        With numbers and units.
    place : str
        The file it stands in, and its folder.
    command : str
        What makes that file; empty for what people state.
    of : str
        The study or fit that it is about; empty for what is about all of them.
    """

    words: str
    place: str
    command: str
    of: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure that another command drew, what stands under it, and whether it shows the run's data."""

    path: Path
    caption: str
    of_data: bool = True


@dataclass(frozen=True)
class Told:
    """What is told of a factor; without `findings` there is a gap, `left` is what they leave open."""

    findings: tuple[Finding, ...] = ()
    left: tuple[str, ...] = ()
    tables: tuple[Display, ...] = ()
    pictures: tuple[Picture, ...] = ()


def joined(*parts: Told) -> Told:
    """Return all of several parts."""
    return Told(
        tuple(finding for part in parts for finding in part.findings),
        tuple(dict.fromkeys(said for part in parts for said in part.left)),
        tuple(table for part in parts for table in part.tables),
        tuple(picture for part in parts for picture in part.pictures),
    )
