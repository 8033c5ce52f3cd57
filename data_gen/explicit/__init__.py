"""Many falls at once: explicit dynamics of quadratic tetrahedra on a GPU, without a solver, and plain pictures of them.

`generate_falls` draws and meshes bodies, `roll_out` moves them, `draw` renders them. The material, the mesh, the floor
and the friction are those of `physconvex.fem`; only the time integration differs (docs/concepts/motion.md).
"""
