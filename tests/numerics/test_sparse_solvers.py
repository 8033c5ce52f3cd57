"""Sparse symmetric solver: both backends, errors, reuse of the pattern, and the warning of the fallback."""

import importlib.util
import sys

import numpy as np
import pytest
import scipy.sparse as sp

from physconvex import InputError, PhysconvexError
from physconvex.numerics import NotPositiveDefiniteError, SymmetricSolver, sparse_solvers as linear_solvers

HAS_PARDISO = importlib.util.find_spec("pypardiso") is not None
BACKENDS = [
    "superlu",
    pytest.param("pardiso", marks=pytest.mark.skipif(not HAS_PARDISO, reason="pypardiso is not installed")),
]


def random_matrix(size: int, seed: int) -> sp.csr_matrix:
    """Upper triangle of a sparse, diagonally dominant (hence positive definite) symmetric matrix."""
    rng = np.random.default_rng(seed)
    off = sp.triu(sp.random(size, size, density=min(1.0, 4 / size), random_state=rng, data_rvs=rng.standard_normal), 1)
    row_sums = np.asarray(abs(off + off.T).sum(axis=1)).ravel()
    return (off + sp.diags(row_sums + rng.uniform(0.1, 1.0, size))).tocsr()


def full(upper: sp.csr_matrix) -> np.ndarray:
    return (upper + sp.triu(upper, 1).T).toarray()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("size", [3, 40, 300])
def test_solves_random_systems(backend, size):
    upper = random_matrix(size, seed=size)
    solver = SymmetricSolver(upper, backend=backend)
    solver.factorise(upper.data)
    rhs = np.random.default_rng(1).normal(size=size)
    np.testing.assert_allclose(full(upper) @ solver.solve(rhs), rhs, atol=1e-10)
    solver.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_several_right_hand_sides_at_once(backend):
    upper = random_matrix(30, seed=7)
    solver = SymmetricSolver(upper, backend=backend)
    solver.factorise(upper.data)
    rhs = np.random.default_rng(2).normal(size=(30, 4))
    np.testing.assert_allclose(full(upper) @ solver.solve(rhs), rhs, atol=1e-11)
    solver.close()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("count", [0, 3, 150])
def test_rows_of_the_inverse(backend, count):
    upper = random_matrix(200, seed=5)
    solver = SymmetricSolver(upper, backend=backend)
    solver.factorise(upper.data)
    numbers = np.random.default_rng(6).permutation(200)[:count]
    np.testing.assert_allclose(solver.inverse_rows(numbers), np.linalg.inv(full(upper))[numbers], atol=1e-12)
    solver.close()


def test_backends_agree():
    pytest.importorskip("pypardiso")
    upper = random_matrix(200, seed=3)
    rhs = np.random.default_rng(4).normal(size=200)
    solutions = []
    for backend in ("pardiso", "superlu"):
        solver = SymmetricSolver(upper, backend=backend)
        solver.factorise(upper.data)
        solutions.append(solver.solve(rhs))
        solver.close()
    np.testing.assert_allclose(*solutions, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("backend", BACKENDS)
def test_new_values_in_the_old_pattern(backend):
    upper = random_matrix(50, seed=5)
    solver = SymmetricSolver(upper, backend=backend)
    rhs = np.random.default_rng(6).normal(size=50)
    for factor in (1.0, 3.0, 0.2):
        scaled = upper.copy()
        scaled.data = upper.data * factor
        scaled.setdiag(scaled.diagonal() + factor)
        solver.factorise(scaled.data)
        np.testing.assert_allclose(full(scaled) @ solver.solve(rhs), rhs, atol=1e-11)
    assert solver.factorisations == 3
    solver.close()


def test_pardiso_analyses_the_pattern_once(monkeypatch):
    pytest.importorskip("pypardiso")
    upper = random_matrix(20, seed=8)
    solver = SymmetricSolver(upper, backend="pardiso")
    phases = []
    original = solver._pardiso.set_phase
    monkeypatch.setattr(solver._pardiso, "set_phase", lambda phase: (phases.append(phase), original(phase)))
    for _ in range(3):
        solver.factorise(upper.data)
    assert phases == [12, 22, 22]  # analysis and factorisation, then factorisation alone
    solver.close()


def test_pardiso_refines_no_solution():
    pytest.importorskip("pypardiso")
    upper = random_matrix(20, seed=8)
    solver = SymmetricSolver(upper, backend="pardiso")
    solver.factorise(upper.data)
    solver.solve(np.ones(20))
    asked, done = solver._pardiso.get_iparm(8), solver._pardiso.get_iparm(7)
    assert (asked, done) == (0, 0)  # where the solver is not told that its settings are meant, it refines twice
    solver.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_indefinite_matrix_is_refused_and_the_solver_lives_on(backend):
    upper = random_matrix(40, seed=9)
    indefinite = upper.copy()
    indefinite[17, 17] = -5.0
    solver = SymmetricSolver(upper, backend=backend)
    with pytest.raises(NotPositiveDefiniteError, match="pivot"):
        solver.factorise(indefinite.data)
    solver.factorise(upper.data)
    rhs = np.arange(40.0)
    np.testing.assert_allclose(full(upper) @ solver.solve(rhs), rhs, atol=1e-10)
    solver.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_values_that_are_not_finite_are_refused(backend):
    upper = random_matrix(10, seed=10)
    solver = SymmetricSolver(upper, backend=backend)
    data = upper.data.copy()
    data[3] = np.nan
    with pytest.raises(NotPositiveDefiniteError, match="not finite"):
        solver.factorise(data)
    solver.close()


def test_singular_matrix_is_refused_by_superlu():
    upper = sp.csr_matrix(np.triu(np.ones((3, 3))))
    with pytest.raises(NotPositiveDefiniteError):
        SymmetricSolver(upper, backend="superlu").factorise(upper.data)


@pytest.fixture
def without_pypardiso(monkeypatch):
    monkeypatch.setitem(sys.modules, "pypardiso", None)  # makes `import pypardiso` raise ImportError
    linear_solvers._pardiso_class.cache_clear()
    yield
    linear_solvers._pardiso_class.cache_clear()


def test_missing_pypardiso_falls_back_with_a_warning(without_pypardiso):
    upper = random_matrix(10, seed=11)
    with pytest.warns(RuntimeWarning, match="pypardiso is not installed.*pip install pypardiso"):
        solver = SymmetricSolver(upper)
    solver.factorise(upper.data)
    np.testing.assert_allclose(full(upper) @ solver.solve(np.ones(10)), 1.0, atol=1e-11)


@pytest.mark.filterwarnings("ignore:pypardiso is not installed")
def test_asking_for_a_missing_pypardiso_is_an_error(without_pypardiso):
    with pytest.raises(InputError, match="pypardiso is not installed"):
        SymmetricSolver(random_matrix(10, seed=12), backend="pardiso")


def test_chosen_superlu_needs_no_pypardiso(without_pypardiso):
    SymmetricSolver(random_matrix(10, seed=13), backend="superlu")  # no warning: warnings are errors here


@pytest.mark.wrong_types
def test_unknown_backend_is_named():
    with pytest.raises(InputError, match="backend: got 'cholmod'"):
        SymmetricSolver(random_matrix(10, seed=14), backend="cholmod")


def test_error_belongs_to_the_family():
    assert issubclass(NotPositiveDefiniteError, PhysconvexError)
