"""The twin: 47 synthetic insertions whose truth is known, and is not the model that is fitted to them."""
