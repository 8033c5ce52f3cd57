"""Many falls at once: explicit dynamics of quadratic tetrahedra on a GPU, without a solver, and plain pictures of them.

`generate_falls` draws and meshes bodies, `roll_out` moves them, `draw` shows them. The material, the mesh, the floor
and the friction are those of `physconvex.fem`; only time is stepped through otherwise (docs/concepts/motion.md).
"""
