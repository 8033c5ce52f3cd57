"""Objects to play: a mesh file, a convex field, or a result of `physconvex refine`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from physconvex.convex import ConvexField, hull_mesh, read_ply
from physconvex.errors import InputError
from physconvex.play.surface import RestSurface, read_surface

_FIELD_MARK = b"element convex "


@dataclass(frozen=True)
class Asset:
    """An object at rest.

    Attributes:
        surface: its surface; of a convex field the hulls, which may overlap.
        convexes: the field, if it is one.
        settings: sections of the configuration from the file, such as a refined material.
    """

    surface: RestSurface
    convexes: ConvexField | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)


def read_asset(path: str | Path) -> Asset:
    """Read a mesh file, a PLY file of a convex field, or a folder of `physconvex refine`.

    Of a refinement the surface at t = 0 and E, ν, damping time and density are used, not the scene of the capture.

    Raises:
        InputError: none of these, or unreadable.
    """
    path = Path(path)
    if path.is_dir():
        return _refined(path)
    if path.suffix.lower() == ".ply" and path.is_file() and _FIELD_MARK in path.read_bytes()[:4000]:
        convexes = read_ply(path)
        hulls = hull_mesh(convexes)
        if hulls.is_empty:
            raise InputError(f"{path}: no convex has a volume; expected a field with solid convexes")
        return Asset(RestSurface(np.asarray(hulls.vertices), np.asarray(hulls.faces)), convexes)
    return Asset(read_surface(path))


def _refined(folder: Path) -> Asset:
    """Surface and material of a refinement."""
    try:
        found = json.loads((folder / "refinement.json").read_text(encoding="utf-8"))
        with np.load(folder / "trajectory.npz") as arrays:
            surface = RestSurface(np.asarray(arrays["vertices"][0], dtype=np.float64), np.asarray(arrays["faces"]))
        known = {name: entry["value"] for name, entry in found["parameters"].items()}
        known |= {name: entry["value"] if isinstance(entry, dict) else entry for name, entry in found["fixed"].items()}
        material = {"youngs_modulus": float(found["youngs_modulus"]["value"])}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{folder}: expected a folder of `physconvex refine` with refinement.json and trajectory.npz ({error})"
        ) from error
    material |= {name: float(known[name]) for name in ("poisson_ratio", "damping_time", "density") if name in known}
    return Asset(surface, settings={"material": material})
