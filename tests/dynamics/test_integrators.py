"""Time steps and Newton's method on problems of a few unknowns with known answers."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from physconvex import ConvergenceError
from physconvex.dynamics import State, bdf2, implicit_euler, minimise
from physconvex.numerics import NotPositiveDefiniteError


@dataclass
class Function:
    """A function of a few variables as an `Objective`; counts its factorisations."""

    value: object
    gradient: object
    hessian: object
    factorised: bool = False
    rounding: float = 0.0
    calls: list = field(default_factory=list)
    matrix: np.ndarray | None = None

    def evaluate(self, x):
        return self.value(x), self.gradient(x)

    def factorise(self, x, *, project):
        self.calls.append(project)
        matrix = self.hessian(x)
        values, vectors = np.linalg.eigh(matrix)
        if values.min() <= 0:
            if not project:
                raise NotPositiveDefiniteError("indefinite")
            matrix = (vectors * np.maximum(values, 1e-3)) @ vectors.T
        self.matrix, self.factorised = matrix, True

    def solve(self, rhs):
        return np.linalg.solve(self.matrix, rhs)


def quadratic(matrix, rhs) -> Function:
    return Function(lambda x: 0.5 * x @ matrix @ x - rhs @ x, lambda x: matrix @ x - rhs, lambda x: matrix)


def rosenbrock() -> Function:
    return Function(
        lambda x: (1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2,
        lambda x: np.array([-2 * (1 - x[0]) - 400 * x[0] * (x[1] - x[0] ** 2), 200 * (x[1] - x[0] ** 2)]),
        lambda x: np.array([[2 - 400 * (x[1] - 3 * x[0] ** 2), -400 * x[0]], [-400 * x[0], 200.0]]),
    )


# --- Newton's method


def test_quadratic_needs_one_step_and_its_check():
    matrix, rhs = np.array([[3.0, 1.0], [1.0, 2.0]]), np.array([1.0, -2.0])
    found = minimise(quadratic(matrix, rhs), np.zeros(2), tolerance=1e-10)
    np.testing.assert_allclose(found.x, np.linalg.solve(matrix, rhs), atol=1e-14)
    assert found.iterations == 2
    assert found.last_step <= 1e-10


@pytest.mark.parametrize("reuse", [True, False])
@pytest.mark.parametrize("start", [(-1.2, 1.0), (0.0, 3.0), (2.0, -5.0)])  # the second one has an indefinite Hessian
def test_banana_valley(reuse, start):
    found = minimise(rosenbrock(), np.array(start), tolerance=1e-10, reuse=reuse)
    np.testing.assert_allclose(found.x, 1.0, atol=1e-9)


def test_indefinite_hessian_is_projected():
    objective = rosenbrock()
    found = minimise(objective, np.array([0.0, 3.0]), tolerance=1e-10)
    assert objective.calls[:2] == [False, True]
    assert found.projections == objective.calls.count(True)


def test_a_positive_definite_hessian_is_never_projected():
    assert minimise(quadratic(np.eye(2), np.ones(2)), np.zeros(2), tolerance=1e-10).projections == 0


def test_never_uphill():
    objective, heights = rosenbrock(), []
    original = objective.factorise
    objective.factorise = lambda x, *, project: (
        heights.append(objective.value(x)),
        original(x, project=project),
    )
    minimise(objective, np.array([-1.2, 1.0]), tolerance=1e-10, reuse=False)
    assert (np.diff(heights) <= 1e-12).all()


def test_an_old_factorisation_is_used_as_long_as_it_contracts():
    objective = quadratic(np.diag([1.0, 2.0]), np.ones(2))
    objective.matrix, objective.factorised = np.diag([1.1, 2.2]), True  # off by 10 %: steps shrink tenfold
    found = minimise(objective, np.zeros(2), tolerance=1e-12)
    assert objective.calls == []
    np.testing.assert_allclose(found.x, [1.0, 0.5], atol=1e-12)


@pytest.mark.parametrize("wrong", [0.2, 30.0])  # steps far too long, steps far too short
def test_a_bad_old_factorisation_is_renewed(wrong):
    objective = quadratic(np.diag([1.0, 2.0]), np.ones(2))
    objective.matrix, objective.factorised = wrong * np.diag([1.0, 2.0]), True
    found = minimise(objective, np.zeros(2), tolerance=1e-12)
    assert objective.calls == [False]
    np.testing.assert_allclose(found.x, [1.0, 0.5], atol=1e-12)


def test_an_old_factorisation_that_points_uphill_is_renewed():
    objective = quadratic(np.diag([1.0, 2.0]), np.ones(2))
    objective.matrix, objective.factorised = -np.eye(2), True
    found = minimise(objective, np.zeros(2), tolerance=1e-12)
    np.testing.assert_allclose(found.x, [1.0, 0.5], atol=1e-12)


def barrier() -> Function:
    """x − ln x: infinite for x ≤ 0, minimum at 1."""
    return Function(
        lambda x: float(x[0] - np.log(x[0])) if x[0] > 0 else np.inf,
        lambda x: np.array([1 - 1 / x[0]]) if x[0] > 0 else np.array([np.nan]),
        lambda x: np.array([[1 / x[0] ** 2]]) if x[0] > 0 else np.array([[np.nan]]),
    )


def test_line_search_stays_where_the_value_is_finite():
    found = minimise(barrier(), np.array([5.0]), tolerance=1e-10)  # the full first step goes to −15
    np.testing.assert_allclose(found.x, 1.0, atol=1e-10)


def drifting(rounding: float) -> Function:
    """A convex function whose value, not its gradient, errs by 1e-6 more at every evaluation."""
    evaluations = iter(range(1000))
    return Function(
        lambda x: float(0.5 * x @ x + 0.02 * (x**4).sum() + 1e-6 * next(evaluations)),
        lambda x: x + 0.08 * x**3,
        lambda x: np.diag(1 + 0.24 * x**2),
        rounding=rounding,
    )


def test_rounding_of_the_value_does_not_stop_newton():
    found = minimise(drifting(rounding=1e-5), np.array([0.5, -0.8]), tolerance=1e-12)
    np.testing.assert_allclose(found.x, 0.0, atol=1e-12)  # far below √1e-6, where the value is lost in its errors


def test_rising_value_stops_newton():
    with pytest.raises(ConvergenceError, match="no descent"):
        minimise(drifting(rounding=0.0), np.array([0.5, -0.8]), tolerance=1e-12)


def test_start_without_finite_value_is_a_convergence_failure():
    with pytest.raises(ConvergenceError, match="start"):
        minimise(barrier(), np.array([-1.0]), tolerance=1e-10)


def test_bound_on_the_number_of_steps():
    with pytest.raises(ConvergenceError, match="3 iterations left a step of"):
        minimise(rosenbrock(), np.array([-1.2, 1.0]), tolerance=1e-12, max_iterations=3)


def test_no_descent_is_an_error():
    lying = Function(lambda x: float(x[0]), lambda x: np.array([-1.0]), lambda x: np.eye(1))  # wrong sign of gradient
    with pytest.raises(ConvergenceError, match="no descent"):
        minimise(lying, np.zeros(1), tolerance=1e-6)


# --- time steps: mass 1, force −ω² x


def oscillate(omega: float, end: float, steps: int, *, two_step: bool) -> State:
    """x(0) = 1, v(0) = 0; the incremental potential of a linear spring has a closed minimiser."""
    h, state, previous = end / steps, State(0.0, np.ones(1), np.zeros(1)), None
    for _ in range(steps):
        c = bdf2(state, previous, h) if two_step and previous else implicit_euler(state, h)
        x = c.target / (1 + (omega * c.step) ** 2)
        previous, state = state, State(state.time + h, x, c.velocity(x))
    return state


@pytest.mark.parametrize(("two_step", "order"), [(False, 1), (True, 2)])
def test_order_of_accuracy(two_step, order):
    omega, end = 2.0, 3.0
    errors = []
    for steps in (200, 400, 800):
        state = oscillate(omega, end, steps, two_step=two_step)
        exact = np.array([np.cos(omega * end), -omega * np.sin(omega * end)])
        errors.append(np.abs(np.concatenate([state.positions, state.velocities]) - exact).max())
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    # the next term of the error is h·ω of the leading one: 0.03 here
    np.testing.assert_allclose(slopes, order, atol=0.1)


def test_implicit_euler_damps_by_the_known_rate():
    # |1/(1 − iωh)| = (1 + ω²h²)^(−1/2) per step: energy decays by ω² h per unit time
    omega, h, steps = 3.0, 1e-2, 500
    state = oscillate(omega, h * steps, steps, two_step=False)
    energy = (state.velocities[0] ** 2 + (omega * state.positions[0]) ** 2) / omega**2
    assert energy == pytest.approx((1 + (omega * h) ** 2) ** -steps, rel=1e-10)


def test_bdf2_damps_by_its_principal_root():
    # amplitudes go like rⁿ with (3 − 4/r + 1/r²)/2 = iωh; v = iω x holds exactly, so the energy has no ripple
    omega, h = 3.0, 1e-2
    root = max(abs(np.roots([3 - 2j * omega * h, -4, 1])))
    energies = []
    for steps in (200, 1200):
        state = oscillate(omega, h * steps, steps, two_step=True)
        energies.append(state.velocities[0] ** 2 + (omega * state.positions[0]) ** 2)
    assert energies[1] / energies[0] == pytest.approx(root**2000, rel=1e-10)
    assert 1 - root**2 == pytest.approx((omega * h) ** 4 / 2, rel=0.01)  # a fourth-order loss of energy per step


def test_stiff_spring_goes_to_rest():
    for two_step in (False, True):
        state = oscillate(1e6, 1.0, 20, two_step=two_step)
        assert np.abs(state.positions[0]) < 1e-6


def test_uniform_motion_is_exact():
    start, v = State(0.0, np.array([1.0, 2.0]), np.array([0.5, -1.0])), np.array([0.5, -1.0])
    c = implicit_euler(start, 0.1)
    np.testing.assert_allclose(c.target, start.positions + 0.1 * v)
    middle = State(0.1, c.target, c.velocity(c.target))
    d = bdf2(middle, start, 0.1)
    np.testing.assert_allclose(d.target, start.positions + 0.2 * v)
    np.testing.assert_allclose(d.velocity(d.target), v)
