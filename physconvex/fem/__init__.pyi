from .body import ElasticBody as ElasticBody
from .carried_contact import CarriedContact as CarriedContact, SurfacePoints as SurfacePoints
from .modes import (
    elastic_responses as elastic_responses,
    rigid_motions as rigid_motions,
    skinning_eigenmodes as skinning_eigenmodes,
    skinning_stiffness as skinning_stiffness,
    tangent_stiffness as tangent_stiffness,
    vibration_modes as vibration_modes,
)
from .nodal_equations import NodalEquations as NodalEquations
from .scene import NodePins as NodePins, Scene as Scene, Trajectory as Trajectory
from .sensitivity import SceneFamily as SceneFamily
from .simulation import solve_static as solve_static
from .surface_loads import surface_load as surface_load
