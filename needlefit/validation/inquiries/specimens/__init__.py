"""How much specimens differ: `verb` learns each, and the population from all; `made_up` ones are known."""
