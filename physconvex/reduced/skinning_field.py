"""A file of skinning weights as the network predicts them: a small MLP of points, independent of the network."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float32
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save
from torch import Tensor, nn

from physconvex.errors import InputError

_FORMAT = "physconvex/skinning_field/1"
_FRAME = "origin: centre of the rest bounding box; x: right in the image; y: away from the camera; z: up"


def _fourier_features(points: Float[Tensor, "... 3"], harmonics: int) -> Float[Tensor, "... F"]:
    """X, and sines and cosines of k π X for k = 1..harmonics; X in units of the object size (within ±1/2)."""
    waves = [torch.pi * k * points for k in range(1, harmonics + 1)]
    return torch.cat([points, *(f(w) for w in waves for f in (torch.sin, torch.cos))], dim=-1)


def fourier_network(
    layers: list[tuple[Tensor, Tensor]], points: Float[Tensor, "*B Q 3"], harmonics: int
) -> Float[Tensor, "*B Q M"]:
    """Values of an MLP over Fourier features, with SiLU between its layers.

    Args:
        layers: weights and biases.
        points: X in units of the object size.
        harmonics: number of multiples of π in the sines and cosines.
    """
    values = _fourier_features(points, harmonics)
    for k, (weight, bias) in enumerate(layers):
        values = values @ weight.transpose(-1, -2) + bias
        if k < len(layers) - 1:
            values = nn.functional.silu(values)
    return values


@dataclass(frozen=True, eq=False)
class SkinningField:
    """Skinning weights of one object, W: X -> R^M, smooth (C^∞), float32.

    The deformation is φ(X) = X + Z₀ [X; 1] + Σₘ Wₘ(X) Zₘ [X; 1]: the constant mode Z₀ is not among the M.

    Object frame: origin at the centre of the rest bounding box, x to the right in the image (horizontal), y away from
    the camera (horizontal), z up; in metres, for the largest rest edge `object_size` [m]. The field is trained inside
    the object; it is valid up to a tenth of its size outside.
    """

    tensors: dict[str, Float32[np.ndarray, "*shape"]] = field(repr=False)
    object_size: float
    harmonics: int

    @property
    def handles(self) -> int:
        """M, without the constant mode."""
        return len(self.tensors[f"bias_{len(self.tensors) // 2 - 1}"])

    def __call__(self, points: Float[np.ndarray, "Q 3"]) -> Float32[np.ndarray, "Q M"]:
        """Weights at points [m] of the object frame."""
        with torch.no_grad():
            return self._weights(self._scaled(points)).numpy()

    def gradient(self, points: Float[np.ndarray, "Q 3"]) -> Float32[np.ndarray, "Q M 3"]:
        """∂W/∂X [1/m] at points [m], exact (automatic differentiation)."""
        jacobian = torch.func.vmap(torch.func.jacrev(lambda point: self._weights(point[None])[0]))
        return jacobian(self._scaled(points)).detach().numpy() / np.float32(self.object_size)

    def save(self, path: str | PathLike[str]) -> None:
        """Write one safetensors file; frame, units and normalisation are JSON in its header."""
        description = {
            "format": _FORMAT,
            "frame": _FRAME,
            "units": {"points": "m", "object_size": "m", "weights": "1"},
            "object_size": self.object_size,
            "handles": self.handles,
            "harmonics": self.harmonics,
            "constant_mode": "implied, not stored",
            "field": "MLP, SiLU between layers, of x = X / object_size and sin, cos(k pi x), k=1..harmonics",
        }
        Path(path).write_bytes(save(self.tensors, metadata={"physconvex": json.dumps(description)}))

    @classmethod
    def load(cls, path: str | PathLike[str]) -> SkinningField:
        """Read a file of `save`.

        Raises:
            InputError: there is no such file, or it has another format.
        """
        if not Path(path).is_file():
            raise InputError(f"path: no skinning field at {str(path)!r}; give a *.safetensors file from `save`")
        try:
            with safe_open(path, framework="numpy") as file:
                description = json.loads((file.metadata() or {}).get("physconvex", "{}"))
                tensors = {name: file.get_tensor(name) for name in file.keys()}
        except SafetensorError as error:
            raise InputError(f"path: {str(path)!r} is no safetensors file ({error}), expected {_FORMAT!r}") from error
        if description.get("format") != _FORMAT:
            raise InputError(f"path: {str(path)!r} is {description.get('format')!r}, expected {_FORMAT!r}")
        return cls(tensors=tensors, object_size=description["object_size"], harmonics=description["harmonics"])

    def _scaled(self, points: Float[np.ndarray, "Q 3"]) -> Float32[Tensor, "Q 3"]:
        values = np.asarray(points, np.float64)
        if values.ndim != 2 or values.shape[1] != 3:
            raise InputError(f"points: got shape {values.shape}, expected [Q, 3], metres in the object frame")
        return torch.from_numpy((values / self.object_size).astype(np.float32))

    def _weights(self, points: Float32[Tensor, "Q 3"]) -> Float32[Tensor, "Q M"]:
        count = len(self.tensors) // 2
        layers = [
            (torch.from_numpy(self.tensors[f"weight_{k}"]), torch.from_numpy(self.tensors[f"bias_{k}"]))
            for k in range(count)
        ]
        return fourier_network(layers, points, self.harmonics)
