"""The lowest vibration of a twin, which matches the dynamics of two meshes."""

from __future__ import annotations

import numpy as np

from physconvex.fem import vibration_modes
from physconvex.gap.base.model import EffectModel


def decades_between(one: EffectModel, other: EffectModel, values: np.ndarray) -> float:
    """Change of log10 E that gives another mesh the lowest frequency of this one."""
    return 2 * float(np.log10(lowest_frequency(one, values) / lowest_frequency(other, values)))


def lowest_frequency(model: EffectModel, values: np.ndarray) -> float:
    """Lowest vibration frequency of the body on the model's mesh [Hz], attached masses included."""
    scene = model.full_scene(values)
    carried = None if scene.hanging is None else scene.hanging_masses
    if scene.held is None:
        return float(vibration_modes(scene.body, 7, carried=carried)[0][6])
    held = np.zeros(len(scene.body.mesh.vertices), dtype=bool)
    held[scene.held.nodes] = True
    return float(vibration_modes(scene.body, 1, clamped=held, carried=carried)[0][0])
