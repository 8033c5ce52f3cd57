"""Location of the gap: sources, time, body, vibrations, impulse and work."""
