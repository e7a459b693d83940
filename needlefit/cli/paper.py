"""`needlefit paper`: the published tables, and where they contradict each other."""

import dataclasses

from needlefit.cli import options, screen


def paper(json: options.Json = False, verbose: options.Verbose = False) -> None:
    """Print the paper's tables and the list of its contradictions."""
    from needlefit.validation import paper as published

    tables = [
        (name, title, published.read_published_table(name)) for name, title in published.TABLE_TITLES.items()
    ]
    contradictions = published.find_contradictions()
    if json:
        rows: dict[str, object] = {name: table.to_dict("records") for name, _, table in tables}
        screen.show_json({**rows, "contradictions": [dataclasses.asdict(claim) for claim in contradictions]})
        return
    for _, title, table in tables:
        screen.show_frame(table, title)
    screen.print_line(f"Contradictions ({len(contradictions)})")
    for number, claim in enumerate(contradictions, start=1):
        screen.print_line(f"{number:3}. {claim.sentence}")
