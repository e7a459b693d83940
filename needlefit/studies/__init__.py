"""Run studies: fit to some insertions, score on others (`run`), compare with published numbers (`paper`)."""
