from .contact import Contact as Contact, Friction as Friction, Obstacle as Obstacle, Plane as Plane, Sphere as Sphere
from .contact_resolvent import resolve as resolve
from .first_guesses import Guide as Guide
from .integrators import (
    IntegratorName as IntegratorName,
    Minimum as Minimum,
    State as State,
    StepCoefficients as StepCoefficients,
    bdf2 as bdf2,
    check_stepping as check_stepping,
    extrapolate as extrapolate,
    frame_states as frame_states,
    implicit_euler as implicit_euler,
    minimise as minimise,
)
from .obstacle_table import obstacle_rows as obstacle_rows
from .stepping import (
    SolvedPass as SolvedPass,
    SolveStatistics as SolveStatistics,
    Stepper as Stepper,
    StepRecord as StepRecord,
)
from .wind import Wind as Wind
