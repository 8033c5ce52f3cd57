"""Fits of effects: one or several, by the reduced model first, and what residuals say of them."""
