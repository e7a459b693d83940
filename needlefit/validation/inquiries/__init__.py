"""Studies that ask something else than "tune on these, score on those": one file a kind."""
