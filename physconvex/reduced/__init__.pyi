from .adjoint import LossGradient as LossGradient, simulate_with_adjoint as simulate_with_adjoint
from .autograd import rollout_of_weights as rollout_of_weights, rollout_positions as rollout_positions
from .basis import (
    CallableWeights as CallableWeights,
    NodalWeights as NodalWeights,
    SkinningBasis as SkinningBasis,
    WeightField as WeightField,
    eigenmode_weights as eigenmode_weights,
    sample_basis as sample_basis,
)
from .bodies import ReducedBodies as ReducedBodies
from .body import ReducedBody as ReducedBody
from .cubature import (
    BodySamples as BodySamples,
    Cubature as Cubature,
    Shell as Shell,
    tet_cubature as tet_cubature,
)
from .elastic_basis import elastic_weights as elastic_weights
from .equations import ReducedEquations as ReducedEquations
from .given_fields import (
    ArrayWeights as ArrayWeights,
    PredictedField as PredictedField,
    StackedWeights as StackedWeights,
    predicted_weights as predicted_weights,
    snapshot_weights as snapshot_weights,
)
from .neural_field import (
    DataFreeEnergy as DataFreeEnergy,
    NeuralFieldOptions as NeuralFieldOptions,
    train_neural_weights as train_neural_weights,
    untrained_neural_weights as untrained_neural_weights,
)
from .neural_weights import NeuralWeights as NeuralWeights
from .parameters import (
    PARAMETERS as PARAMETERS,
    parameter_values as parameter_values,
    with_parameters as with_parameters,
)
from .scene import ReducedScene as ReducedScene
from .scene_weights import (
    even_loads as even_loads,
    held_nodes as held_nodes,
    touched_loads as touched_loads,
    weights_for_motion as weights_for_motion,
    with_elastic_weights as with_elastic_weights,
)
from .sensitivity import NamedParameters as NamedParameters
from .skinning_field import SkinningField as SkinningField, fourier_network as fourier_network
from .space import ReducedSpace as ReducedSpace
from .trajectory import BodiesTrajectory as BodiesTrajectory, ReducedTrajectory as ReducedTrajectory
