"""Differentiable images of convex fields."""

from physconvex.render.projection import Splats, project
from physconvex.render.rasterize import RenderedImage, render
from physconvex.render.view import View

__all__ = ["RenderedImage", "Splats", "View", "project", "render"]
