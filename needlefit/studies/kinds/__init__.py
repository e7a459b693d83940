"""Kinds of study: what each computes (`run`), and how its results are reported (`report`)."""
