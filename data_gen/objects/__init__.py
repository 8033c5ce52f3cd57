"""Bodies to simulate: procedural ones without end, and the user's meshes."""

from data_gen.objects.library import FAMILIES, ObjectMesh, random_object
from data_gen.objects.user_meshes import load_user_mesh, objects_from_folder

__all__ = ["FAMILIES", "ObjectMesh", "load_user_mesh", "objects_from_folder", "random_object"]
