"""Whether the model is solved rightly: every figure is measured when asked for, none is stored."""
