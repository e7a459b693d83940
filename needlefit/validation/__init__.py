"""Studies: tune on these insertions, score on those (`run`), beside what the paper printed (`paper`)."""
