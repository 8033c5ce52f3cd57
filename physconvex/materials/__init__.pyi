from .body import MaterialBody as MaterialBody, StepViscosity as StepViscosity
from .combined_flows import Flows as Flows, stored_flows as stored_flows
from .inelastic import (
    FlowRule as FlowRule,
    FlowStep as FlowStep,
    Plasticine as Plasticine,
    Sand as Sand,
    StandardLinearSolid as StandardLinearSolid,
)
from .laws import (
    LAWS as LAWS,
    Law as Law,
    LawName as LawName,
    checked_constant as checked_constant,
    get_law as get_law,
    isotropic_stress as isotropic_stress,
    lame_parameters as lame_parameters,
    project_to_positive as project_to_positive,
    strain_rate as strain_rate,
    strain_stiffness as strain_stiffness,
    viscous_stress as viscous_stress,
)
from .strain_terms import (
    combined as combined,
    less_ground as less_ground,
    with_fibres as with_fibres,
    with_strain_stiffening as with_strain_stiffening,
)
from .volumetric import (
    KERNEL_LAWS as KERNEL_LAWS,
    NEARLY_FLAT as NEARLY_FLAT,
    MaterialPoints as MaterialPoints,
    cofactor_and_determinant as cofactor_and_determinant,
    energy_and_stress as energy_and_stress,
    nearly_flat as nearly_flat,
    slopes_of_volume as slopes_of_volume,
)
