"""A study of tip tracks as print has it."""
