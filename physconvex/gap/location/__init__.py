"""Where the gap lies: sources, time, body, vibrations, impulse and work."""
