"""Fits of one or several effects, by the reduced model first, and their evidence."""
