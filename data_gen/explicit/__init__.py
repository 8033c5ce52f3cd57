"""Many falls at once: explicit dynamics of quadratic tetrahedra on a GPU, without a solver, and plain pictures of them.

`generate_falls` draws and meshes bodies, `roll_out` moves them, `draw` shows them. The material, the mesh, the floor
and the friction are those of `physconvex.fem`; only time is stepped through otherwise (docs/training.md).
"""

from data_gen.explicit.bodies import FallingBody, Layout, falling_body, lay_out
from data_gen.explicit.generate import draw_falls, generate_falls, read_falls
from data_gen.explicit.kernels import draw, roll_out

__all__ = [
    "FallingBody",
    "Layout",
    "draw",
    "draw_falls",
    "falling_body",
    "generate_falls",
    "lay_out",
    "read_falls",
    "roll_out",
]
