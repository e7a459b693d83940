"""From a dataset and a model to fitted parameters with what the data say of them."""
