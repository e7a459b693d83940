"""Generate the synthetic dataset: 47 insertions with known truth, by another model than the fitted one."""
