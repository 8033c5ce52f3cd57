"""Test-time refinement: a capture → material, motion and their uncertainty."""
