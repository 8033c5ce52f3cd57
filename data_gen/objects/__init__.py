"""Bodies to simulate: procedural ones without end, and the user's meshes."""

from data_gen.objects.library import FAMILIES, ObjectMesh, random_object

__all__ = ["FAMILIES", "ObjectMesh", "random_object"]
