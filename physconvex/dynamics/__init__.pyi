from .contact import (
    Contact as Contact,
    Friction as Friction,
    Obstacle as Obstacle,
    Plane as Plane,
    Sphere as Sphere,
    contact_defaults as contact_defaults,
    obstacle_rows as obstacle_rows,
)
from .contact_resolvent import resolve as resolve
from .integrators import (
    GuessErrors as GuessErrors,
    IntegratorName as IntegratorName,
    Minimum as Minimum,
    State as State,
    StepCoefficients as StepCoefficients,
    bdf2 as bdf2,
    extrapolate as extrapolate,
    implicit_euler as implicit_euler,
    minimise as minimise,
    step_coefficients as step_coefficients,
)
from .loads import HangingLoad as HangingLoad, Loads as Loads, Pins as Pins, Wind as Wind
from .simulation import (
    FrameStates as FrameStates,
    SensitiveTrajectory as SensitiveTrajectory,
    simulate as simulate,
    simulate_with_sensitivities as simulate_with_sensitivities,
)
from .stepping import (
    Observer as Observer,
    PreparedRollOut as PreparedRollOut,
    SolvedPass as SolvedPass,
    SolveStatistics as SolveStatistics,
    Stepper as Stepper,
    StepRecord as StepRecord,
)
from .timing import ContactSolver as ContactSolver, Timing as Timing
from .world import World as World, in_world as in_world
