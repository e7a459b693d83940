"""What is left of other commands beside a run, and whether it is about the same thing."""
