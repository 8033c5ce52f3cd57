"""A convex field as a file: PLY, one element `convex` per convex and every number exact, or its hulls as a mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
import trimesh

from physconvex.convex.field import ConvexField, numbers
from physconvex.convex.hull_points import hull_triangles, planar_corners
from physconvex.convex.spherical_harmonics import GREATEST_DEGREE, MIDDLE, harmonic_basis
from physconvex.errors import InputError

HEADER = "ply\nformat binary_little_endian 1.0\n"
COMMENTS = (
    "convex field of physconvex; SI units, world frame",
    "hull of the points (x_k y_k z_k) [m]; f_h [m] distances to its faces",
    "occupancy sigmoid(-sharpness log sum_h exp(smoothness f_h))",
    "smoothness [1/m], sharpness [-], opacity [-]; colour max(0, 1/2 + sum_i (red_i green_i blue_i) Y_i(direction))",
)
TYPES = {"float": "<f4", "double": "<f8"}
NAMES = {torch.float32: "float", torch.float64: "double"}


def _properties(points: int, coefficients: int) -> list[str]:
    """Names of the columns of a file."""
    names = [f"{axis}_{point}" for point in range(points) for axis in "xyz"]
    names += ["smoothness", "sharpness", "opacity"]
    return names + [f"{colour}_{i}" for i in range(coefficients) for colour in ("red", "green", "blue")]


def write_ply(field: ConvexField, path: str | Path) -> None:
    """Write all attributes, float32 or float64 as they are.

    Raises:
        InputError: a field of another floating type.
    """
    if field.points.dtype not in NAMES:
        raise InputError(f"field: got {field.points.dtype}; a PLY file holds float32 or float64, convert with .to()")
    kind = NAMES[field.points.dtype]
    names = _properties(field.points.shape[1], field.harmonics.shape[1])
    columns = [tensor.detach().cpu().reshape(len(field), tensor.shape[1:].numel()) for tensor in field.tensors()]
    table = torch.cat(columns, dim=1).numpy().astype(TYPES[kind])
    lines = [f"comment {comment}" for comment in COMMENTS] + [f"element convex {len(field)}"]
    lines += [f"property {kind} {name}" for name in names] + ["end_header"]
    Path(path).write_bytes((HEADER + "\n".join(lines) + "\n").encode("ascii") + table.tobytes())


def read_ply(path: str | Path) -> ConvexField:
    """Read a file of `write_ply`.

    Raises:
        InputError: no such file, another kind of PLY file, truncated, or values out of range.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    head, found, body = content.partition(b"end_header\n")
    header = head.decode("ascii", errors="replace")
    if not found or not header.startswith(HEADER):
        raise InputError(f"{path}: expected a binary little-endian PLY file of a convex field")
    lines = [line.split() for line in header.splitlines()[2:] if not line.startswith("comment")]
    count, kind, names = _layout(path, lines)
    size = count * len(names) * np.dtype(TYPES[kind]).itemsize
    if len(body) != size:
        raise InputError(f"{path}: got {len(body)} bytes of data; the header promises {size}; the file is damaged")
    table = torch.from_numpy(np.frombuffer(body, TYPES[kind]).reshape(count, len(names)).copy())
    points = names.index("smoothness") // 3
    flat = table.split([3 * points, 1, 1, 1, len(names) - 3 * points - 3], dim=1)
    corners = flat[0].reshape(count, points, 3)
    harmonics = flat[4].reshape(count, flat[4].shape[1] // 3, 3)
    field = ConvexField(corners, flat[1][:, 0], flat[2][:, 0], flat[3][:, 0], harmonics)
    field.check_values()
    return field


def _layout(path: Path, lines: list[list[str]]) -> tuple[int, str, list[str]]:
    """Number of convexes, type and names of the columns that a header declares."""
    if lines and len(lines[0]) == 3 and lines[0][:2] == ["element", "convex"] and lines[0][2].isdigit():
        rows = [line for line in lines[1:] if len(line) == 3 and line[0] == "property" and line[1] in TYPES]
        names, kinds = [line[2] for line in rows], {line[1] for line in rows}
        known = [
            _properties(names.index("smoothness") // 3, (degree + 1) ** 2)
            for degree in range(GREATEST_DEGREE + 1)
            if "smoothness" in names
        ]
        if len(rows) == len(lines) - 1 and len(kinds) == 1 and names in known:
            return int(lines[0][2]), kinds.pop(), names
    raise InputError(f"{path}: no convex field: expected one element `convex` with the properties that write_ply names")


def hull_mesh(field: ConvexField) -> trimesh.Trimesh:
    """All hulls as one mesh [m], each vertex with its convex's mean colour and opacity.

    Flat convexes are drawn from both sides. Those whose points lie on a line are omitted; the mesh is empty if all do.
    """
    colours = _mean_colours(field)
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    count = 0
    for points, colour in zip(numbers(field.points), colours, strict=True):
        corners, triangles = _hull_or_face(points)
        if len(corners):
            parts.append((points[corners], triangles + count, np.tile(colour, (len(corners), 1))))
            count += len(corners)
    if not parts:
        return trimesh.Trimesh()
    vertices, faces, rgba = (np.concatenate(part) for part in zip(*parts, strict=True))
    return trimesh.Trimesh(vertices, faces, vertex_colors=rgba, process=False)


def _hull_or_face(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a hull and its triangles; of points in a plane, both sides of their face; none on a line."""
    if np.linalg.matrix_rank(points - points[0], tol=1e-9 * np.ptp(points)) == 3:
        return hull_triangles(points)
    corners = planar_corners(points)
    fan = np.array([[0, k, k + 1] for k in range(1, len(corners) - 1)], dtype=np.int64).reshape(-1, 3)
    return corners, np.concatenate([fan, fan[:, ::-1]])


def write_glb(field: ConvexField, path: str | Path) -> None:
    """Write the hulls for any viewer of glTF files.

    Raises:
        InputError: no convex has a face.
    """
    mesh = hull_mesh(field)
    if mesh.is_empty:
        raise InputError("field: no convex has a face; there is nothing to write")
    mesh.export(Path(path), file_type="glb")


def _mean_colours(field: ConvexField) -> np.ndarray:
    """Colour averaged over directions (the first coefficient) and opacity, [N, 4] of 0 to 255."""
    up = torch.tensor([0.0, 0.0, 1.0], dtype=field.points.dtype)
    constant = harmonic_basis(up, 0)
    rgb = MIDDLE + constant * field.harmonics[:, 0].detach().cpu()
    rgba = torch.cat([rgb, field.opacity.detach().cpu()[:, None]], dim=1).clamp(0, 1)
    return (rgba * 255).round().to(torch.uint8).numpy()
