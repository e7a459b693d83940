"""The physics: nouns (needle, tissue, control), the model twice (`reference`, `kernel`), the verb `simulate`.

Knows no data and no files; docs/model.md states the equations.
"""
