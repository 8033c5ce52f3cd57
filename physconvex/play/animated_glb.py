"""A moving surface as one animated GLB file: morph targets, one per frame (glTF 2.0, §3.7.2.2)."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

_FLOAT, _UNSIGNED, _VERTICES, _INDICES = 5126, 5125, 34962, 34963
_Y_UP = [-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]  # glTF's y axis is up


class _Buffer:
    """Arrays one after the other, with their accessors."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, array: np.ndarray, kind: str, *, target: int | None = None, bounds: bool = False) -> int:
        """Append an array; returns the number of its accessor."""
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes}
        if target is not None:
            view["target"] = target
        self.views.append(view)
        self.data += array.tobytes()
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": _FLOAT if array.dtype == np.float32 else _UNSIGNED,
            "count": len(array),
            "type": kind,
        }
        if bounds:
            rows = array.reshape(len(array), -1)
            accessor["min"], accessor["max"] = rows.min(0).tolist(), rows.max(0).tolist()
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def write_animated_glb(
    path: str | Path,
    times: Float[np.ndarray, " T"],
    positions: Float[np.ndarray, "T V 3"],
    faces: Int[np.ndarray, "F 3"],
    *,
    color: tuple[float, float, float] = (0.69, 0.17, 0.05),
) -> None:
    """Write a surface in motion.

    Args:
        path: the file.
        times: of the frames [s].
        positions: of the vertices [m], z up (turned for glTF, whose y axis is up).
        faces: triangles.
        color: linear RGB of the surface.
    """
    buffer, count = _Buffer(), len(positions)
    first = positions[0].astype(np.float32)
    indices = buffer.add(faces.astype(np.uint32).ravel(), "SCALAR", target=_INDICES)
    base = buffer.add(first, "VEC3", target=_VERTICES, bounds=True)
    moved = [
        buffer.add((frame - positions[0]).astype(np.float32), "VEC3", target=_VERTICES, bounds=True)
        for frame in positions[1:]
    ]
    primitive: dict[str, Any] = {"attributes": {"POSITION": base}, "indices": indices, "material": 0}
    surface: dict[str, Any] = {"primitives": [primitive]}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "physconvex"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": _Y_UP}],
        "meshes": [surface],
        "materials": [
            {"pbrMetallicRoughness": {"baseColorFactor": [*color, 1.0], "metallicFactor": 0.0}, "doubleSided": True}
        ],
    }
    if moved:
        primitive["targets"] = [{"POSITION": number} for number in moved]
        surface["weights"] = [0.0] * len(moved)
        shown = np.eye(count, count - 1, k=-1, dtype=np.float32)  # frame t shows target t − 1
        sampler = {
            "input": buffer.add(np.asarray(times, dtype=np.float32), "SCALAR", bounds=True),
            "output": buffer.add(shown.ravel(), "SCALAR"),
            "interpolation": "LINEAR",
        }
        channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
        document["animations"] = [{"samplers": [sampler], "channels": [channel]}]
    document |= {
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    Path(path).write_bytes(_container(json.dumps(document).encode(), bytes(buffer.data)))


def _container(text: bytes, data: bytes) -> bytes:
    """The two chunks of a GLB file, padded to four bytes."""
    text, data = text.ljust(-(-len(text) // 4) * 4), data.ljust(-(-len(data) // 4) * 4, b"\0")
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
