"""Unstated conditions of a recording: compliant floors, the program's own elements, strong damping."""
