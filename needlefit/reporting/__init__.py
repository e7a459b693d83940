"""Results -> tables, figures and documents (`write`): the only room that draws."""
