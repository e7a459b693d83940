"""The input log of an interactive insertion: written as it happens, read, and carried out again."""
