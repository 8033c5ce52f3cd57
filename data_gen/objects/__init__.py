"""Bodies to simulate: procedural ones without end, and the user's meshes."""
