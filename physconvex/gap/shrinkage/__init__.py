"""How far the gap shrinks: on held-out frames, in held-out views, on a second take."""
