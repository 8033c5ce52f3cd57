from .fitting import (
    broyden_update as broyden_update,
    huber_loss as huber_loss,
    huber_weights as huber_weights,
    moved_along as moved_along,
)
from .rotations import (
    best_rotation as best_rotation,
    beyond_rigid as beyond_rigid,
    rotation_matrix as rotation_matrix,
    turning_rates as turning_rates,
)
from .sparse_solvers import NotPositiveDefiniteError as NotPositiveDefiniteError, SymmetricSolver as SymmetricSolver
from .torch_settings import device_named as device_named, one_torch_thread as one_torch_thread
from .triangles import closest_in_triangles as closest_in_triangles, closest_points as closest_points
