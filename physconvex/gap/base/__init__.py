"""The fit of the base model: observations, free parameters, weights of residuals, cost of runs."""
