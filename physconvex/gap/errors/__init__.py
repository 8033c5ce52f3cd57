"""Errors of residuals without any effect (noise, numerical error), and scores against them."""
