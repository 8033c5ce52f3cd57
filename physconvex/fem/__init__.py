"""Full-order finite elements: the physical truth that the rest of physconvex is measured against."""

from physconvex.fem.mesh import TetMesh, box_mesh, refine, to_quadratic

__all__ = ["TetMesh", "box_mesh", "refine", "to_quadratic"]
