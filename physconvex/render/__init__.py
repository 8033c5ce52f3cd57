"""Differentiable images of convex fields."""

from physconvex.native import KernelUnavailable
from physconvex.render.jacobian import ImageJacobian, render_jacobian
from physconvex.render.movies import film, orbit
from physconvex.render.projection import Splats, project
from physconvex.render.rasterize import RenderedImage, render
from physconvex.render.view import View

__all__ = [
    "ImageJacobian",
    "KernelUnavailable",
    "RenderedImage",
    "Splats",
    "View",
    "film",
    "orbit",
    "project",
    "render",
    "render_jacobian",
]
