"""A scene in which every effect of the reduced simulator is at work."""

import numpy as np

from physconvex.dynamics import Plane, Sphere, Wind
from physconvex.reduced import ReducedBody, ReducedScene


def sliding(body: ReducedBody, seed: int = 0, **fields) -> ReducedScene:
    """A deformed body that hits a tilted rough plane and a rough ball with damping, drag and spin."""
    rng = np.random.default_rng(seed)
    defaults = {
        "obstacles": (
            Plane(point=(0, 0, -0.004), normal=(0.1, 0.05, 1.0), friction=0.3, velocity=(0.1, 0, 0)),
            Sphere(center=(0.36, 0.1, 0.05), radius=0.05, friction=0.15),
        ),
        "damping_time": 3e-3,
        "contact_damping": 2e-3,
        "air_drag": 0.5,
        "push": lambda t: (20 * t, -1.0, 0.5),
        "wind": Wind((3.0, 1.0, -0.5), drag_coefficient=20.0),
        "contact_smoothing": 0.004,
        "slip_velocity": 0.3,
        "initial_velocity": (0.6, -0.2, -0.7),
        "initial_angular_velocity": tuple(rng.normal(size=3)),
        "initial_orientation": (0.1, -0.2, 0.3),
        "initial_coordinates": body.rest + 0.001 * rng.normal(size=body.rest.shape),
    }
    return ReducedScene(body, **(defaults | fields))
