"""Known constants → tracks → wrong start → the constants again; what the search says of what it cannot tell."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex import ConvergenceError, InputError
from physconvex.identify import (
    FitOptions,
    FullModel,
    MarkerObservations,
    Parameter,
    ReducedModel,
    correct,
    default_parameter,
    default_parameters,
    fit,
    identifiability,
    marginal_deviations,
    marker_observations,
    noise_covariance,
    scan,
)
from physconvex.reduced import parameter_values

TRUTH = np.array([np.log10(2e4), 0.38])


@pytest.fixture(scope="module")
def seen(box_capture):
    return marker_observations(box_capture)


@pytest.fixture(scope="module")
def unknowns(box_twin):
    return default_parameters(box_twin, free=["initial_velocity_z"])


@pytest.fixture(scope="module")
def model(box_twin, seen, unknowns):
    return ReducedModel(box_twin, tuple(p.name for p in unknowns), seen.points, 5)


def test_constants_are_recovered_where_the_start_is_half_a_decade_off(model, seen, unknowns):
    start = [unknowns[0].at(TRUTH[0] + 0.4), unknowns[1].at(0.2), unknowns[2]]
    found = fit(model, seen, start)
    assert found.converged
    np.testing.assert_allclose(found.values, [*TRUTH, -0.5], atol=1e-3)
    assert found.misfit < 1e-2 < found.history[0].misfit
    assert found.value("poisson_ratio") == found.values[1]


def test_the_dashpot_of_the_floor_is_found(box_twin, seen):
    names, truth = ("log10_youngs_modulus", "poisson_ratio", "contact_damping"), np.array([*TRUTH, 4e-3])
    bouncing = ReducedModel(box_twin, names, seen.points, 7)
    motion = bouncing.positions(truth)
    assert np.abs(motion - bouncing.positions(np.array([*TRUTH, 1e-6]))).max() > 1e-3  # it costs bounce
    tracks = MarkerObservations(seen.points, motion, np.full(motion.shape[:2], 2e-4))
    found = fit(bouncing, tracks, [default_parameter(n, start=v) for n, v in zip(names, (4.4, 0.3, 0.0), strict=True)])
    assert found.converged
    np.testing.assert_allclose(found.values, truth, rtol=2e-3)


POSE = tuple(f"initial_{kind}_{axis}" for kind in ("position", "orientation") for axis in "xyz")


@pytest.mark.parametrize("kind", [ReducedModel, FullModel])
def test_the_initial_pose_is_found_beside_the_modulus(kind, box_twin, seen):
    """The box lies otherwise than its mesh has it: by millimetres and hundredths of a radian."""
    names = ("log10_youngs_modulus", *POSE)
    there = parameter_values(box_twin.scene, POSE)
    truth = np.array([TRUTH[0], *np.add(there, [2e-3, -1e-3, 3e-3, 0.02, -0.01, 0.03])])
    model = kind(box_twin, names, seen.points, 5)
    motion = model.positions(truth)
    tracks = MarkerObservations(seen.points, motion, np.full(motion.shape[:2], 1e-4))
    start = [default_parameter(n, start=v) for n, v in zip(names, (4.2, *there), strict=True)]
    found = fit(model, tracks, start)
    assert found.converged
    np.testing.assert_allclose(found.values, truth, atol=2e-4)


@pytest.mark.parametrize("kind", [ReducedModel, FullModel])
def test_the_height_of_the_floor_is_found_beside_the_modulus(kind, box_twin, seen):
    """The floor lies two millimetres lower than stated, so that the box lands later: E alone cannot explain it."""
    names, truth = ("log10_youngs_modulus", "floor_height"), np.array([TRUTH[0], -2e-3])
    model = kind(box_twin, names, seen.points, 6)
    motion = model.positions(truth)
    tracks = MarkerObservations(seen.points, motion, np.full(motion.shape[:2], 1e-4))
    start = [default_parameter(n, start=v) for n, v in zip(names, (4.2, 0.0), strict=True)]
    found = fit(model, tracks, start)
    assert found.converged
    np.testing.assert_allclose(found.values, truth, atol=2e-4)
    held = fit(replace(model, names=names[:1]), tracks, start[:1])
    assert held.misfit > 100 * max(found.misfit, 1e-3) and abs(held.values[0] - truth[0]) > 0.02


def test_a_scan_escapes_a_wrong_start(model, seen, unknowns):
    candidates = scan(model, seen, unknowns, moduli=(3.4, 4.2, 5.0), ratios=(0.3,))
    assert [c.misfit for c in candidates] == sorted(c.misfit for c in candidates)
    assert candidates[0].log10_youngs_modulus == 4.2
    assert candidates[0].parameters[0].upper == unknowns[0].upper  # free again


def test_the_model_s_jacobian_against_differences(model, seen):
    values = np.array([4.35, 0.3, -0.45])
    tight = replace(model, timing=replace(model.twin.timing(), tolerance=1e-10))
    _, jacobian = seen.linearise(*tight.linearise(values))
    for k, step in enumerate((1e-5, 1e-5, 1e-5)):
        shift = step * np.eye(3)[k]
        slope = (seen.residuals(tight.positions(values + shift)) - seen.residuals(tight.positions(values - shift))) / (
            2 * step
        )
        assert np.linalg.norm(jacobian[:, k] - slope) < 1e-3 * np.linalg.norm(slope)


class Line:
    """Positions linear in two parameters, of which the second has no effect unless it is given one."""

    names = ("log10_youngs_modulus", "poisson_ratio")

    def __init__(self, second: float = 1.0) -> None:
        self.directions = np.random.default_rng(1).normal(size=(4, 2, 6, 3)) * np.array([1.0, second])[:, None, None]

    def positions(self, values):
        return np.einsum("tkpi,k->tpi", self.directions, values)

    def linearise(self, values):
        return self.positions(values), self.directions


def line_markers(line, values, noise=0.0, sigma=0.01, seed=0):
    from physconvex.identify import MarkerObservations

    exact = line.positions(np.array(values))
    noisy = exact + np.random.default_rng(seed).normal(scale=noise, size=exact.shape) if noise else exact
    return MarkerObservations(np.zeros((6, 3)), noisy, np.full((4, 6), sigma))


class Valley:
    """One parameter p: a straight line of positions, and a parabola away from what can be reached."""

    names = ("log10_youngs_modulus",)

    def __init__(self, bend: float) -> None:
        self.line, self.away = np.linalg.qr(np.random.default_rng(2).normal(size=(72, 2)))[0].T.reshape(2, 4, 6, 3)
        self.bend = bend

    def positions(self, values):
        return self.linearise(values)[0]

    def linearise(self, values):
        p = values[0] - 4.5
        return p * self.line + 0.5 * self.bend * p**2 * self.away, (self.line + self.bend * p * self.away)[:, None]


@pytest.mark.parametrize("curvature", [0.3, 0.6, 0.9])
def test_steps_that_turn_back_and_forth_are_shortened(curvature):
    """The residual stays 1000 σ; a linearisation alone multiplies the distance from the best p by −curvature."""
    valley = Valley(curvature)
    seen = MarkerObservations(np.zeros((6, 3)), -valley.away, np.full((4, 6), 1e-3))
    start = [default_parameter("log10_youngs_modulus", start=4.8)]
    options = FitOptions(relative_tolerance=1e-12, absolute_tolerance=1e-12, max_iterations=40)
    found = fit(valley, seen, start, options=options)
    assert found.converged and found.evaluations <= 7
    assert found.values[0] == pytest.approx(4.5, abs=1e-5)


class Counted(Valley):
    """Counts what is asked of it, and fails below a modulus."""

    def __init__(self, bend: float, differenced: bool, least: float = -np.inf) -> None:
        super().__init__(bend)
        self.differenced, self.least, self.asked = differenced, least, []

    def positions(self, values):
        if values[0] < self.least:
            raise ConvergenceError("too soft")
        self.asked.append("positions")
        return super().linearise(values)[0]

    def linearise(self, values):
        if values[0] < self.least:
            raise ConvergenceError("too soft")
        self.asked.append("linearise")
        return super().linearise(values)


@pytest.mark.parametrize("least", [-np.inf, 4.35])  # a step too long makes the misfit grow, or the model fail
def test_steps_turned_down_take_no_derivatives_that_cost_runs_of_their_own(least):
    """The search goes the same way, and further, since what it did not take counts half."""
    found, models = [], [Counted(6.0, differenced, least) for differenced in (False, True)]
    for model in models:
        seen = MarkerObservations(np.zeros((6, 3)), -model.away, np.full((4, 6), 1e-3))
        start = [default_parameter("log10_youngs_modulus", start=5.2)]
        found.append(fit(model, seen, start, options=FitOptions(max_iterations=6, relative_tolerance=1e-12)))
    plain, apart = found
    assert plain.evaluations == 6 and plain.evaluations - len(plain.history) >= 2
    assert models[0].asked.count("positions") == 0
    assert models[1].asked.count("linearise") == len(apart.history)
    assert len(apart.history) + 0.5 * (apart.evaluations - len(apart.history)) == 6
    assert len(apart.history) > len(plain.history)
    for mine, other in zip(plain.history, apart.history, strict=False):
        assert mine.misfit == other.misfit


UNKNOWN = (
    Parameter("log10_youngs_modulus", 4.0, 3.0, 8.0, 0.2),
    Parameter("poisson_ratio", 0.3, 0.0, 0.495, 0.1),
)


def test_intervals_cover_the_truth_as_often_as_they_say():
    line, inside = Line(), []
    for seed in range(200):
        found = fit(line, line_markers(line, (5.0, 0.3), noise=0.01, seed=seed), UNKNOWN)
        deviations = np.sqrt(np.diag(noise_covariance(found)))
        inside.append(np.abs(found.values - [5.0, 0.3]) < 1.645 * deviations)
    # 400 draws of a share of .9: three standard deviations are .045
    assert np.mean(inside) == pytest.approx(0.9, abs=0.045)


def test_noise_that_is_not_as_stated_is_carried_through_the_weights_that_were_used():
    """Half of the residuals are ten times as quiet as stated; the fit does not know."""
    line, values = Line(), []
    stated = line_markers(line, (5.0, 0.3), noise=0.0, sigma=0.1)
    quiet = np.arange(len(stated.frames)) % 2 == 0
    rng = np.random.default_rng(0)
    for _ in range(400):
        noise = rng.normal(size=len(quiet)) * np.where(quiet, 0.01, 0.1)
        made = replace(stated, positions=stated.positions + noise.reshape(stated.positions.shape))
        found = fit(line, made, UNKNOWN)
        values.append(found.values)
    told = marginal_deviations(found, np.where(quiet, 0.01, 1.0))
    np.testing.assert_allclose(np.std(values, axis=0), told, rtol=0.12)  # three deviations of a standard deviation
    np.testing.assert_allclose(marginal_deviations(found, 0.25), 0.5 * marginal_deviations(found), rtol=1e-9)
    assert (told < 0.8 * marginal_deviations(found)).all()


def test_a_parameter_at_its_bound_is_said_to_be_there():
    line = Line()
    found = fit(line, line_markers(line, (5.0, 0.7)), UNKNOWN)
    assert found.value("poisson_ratio") == pytest.approx(0.495)
    told = identifiability(found)
    assert told.at_bounds == ("poisson_ratio",)
    assert any("bound" in sentence for sentence in told.sentences)
    assert noise_covariance(found)[1, 1] == 0


def test_intervals_beside_a_parameter_at_its_bound_still_cover_the_truth():
    """Noise drives ν to its bound in some third of the draws; E, which goes with it, is off by what ν is."""
    line, inside = Line(), []
    line.directions[:, 1] += 5.0 * line.directions[:, 0]
    for seed in range(300):
        found = fit(line, line_markers(line, (5.0, 0.488), noise=0.1, seed=seed, sigma=0.1), UNKNOWN)
        held = np.sqrt(np.diag(noise_covariance(found)))
        if found.value("poisson_ratio") < 0.495 - 1e-9:
            np.testing.assert_allclose(marginal_deviations(found), held, rtol=1e-6)
            continue
        error = abs(found.values[0] - 5.0)
        inside.append([error < 1.645 * held[0], error < 1.645 * marginal_deviations(found)[0]])
    assert len(inside) > 60
    held, free = np.mean(inside, axis=0)
    assert held < 0.6 and free > 0.9


def test_what_the_data_leave_open_has_no_small_deviation():
    line = Line(second=1e-9)
    found = fit(line, line_markers(line, (5.0, 0.3)), UNKNOWN)
    for variances in (1.0, 0.01):
        modulus, ratio = marginal_deviations(found, variances)
        assert ratio > 1e4 and modulus < 0.1


def test_a_direction_without_effect_is_named():
    line = Line(second=1e-9)
    told = identifiability(fit(line, line_markers(line, (5.0, 0.3)), UNKNOWN))
    assert told.condition > 1e6
    assert [d.shares[0][0] for d in told.null_directions] == ["poisson_ratio"]
    assert any("do not determine poisson_ratio" in s for s in told.sentences)
    clear = Line()
    assert identifiability(fit(clear, line_markers(clear, (5.0, 0.3)), UNKNOWN)).sentences == (
        "All parameters are determined by the data.",
    )


def test_a_prior_decides_what_the_data_leave_open():
    line = Line(second=1e-9)
    unknown = (UNKNOWN[0], replace(UNKNOWN[1], prior_mean=0.41, prior_sigma=0.02))
    found = fit(line, line_markers(line, (5.0, 0.3)), unknown)
    assert found.value("poisson_ratio") == pytest.approx(0.41, abs=1e-3)
    assert np.sqrt(noise_covariance(found)[1, 1]) == pytest.approx(0.02, rel=1e-3)


def test_one_outlier_does_not_move_a_robust_fit():
    line = Line()
    seen = line_markers(line, (5.0, 0.3), noise=0.01)
    seen.positions[2, 3] += 5.0
    errors = [
        np.abs(fit(line, replace(seen, robust_scale=scale), UNKNOWN).values - [5.0, 0.3]).max()
        for scale in (np.inf, 2.0)
    ]
    assert errors[1] < 0.01 < errors[0]


class Bent(Line):
    """A model that another one, with a shift and a stretch, is the truth of."""

    def positions(self, values):
        return super().positions(values * np.array([1.05, 0.9]) + np.array([-0.1, 0.02]))


def test_the_correction_removes_the_error_of_the_cheap_model():
    cheap, full = Line(), Bent()
    seen = line_markers(full, (5.0, 0.3))
    start = fit(cheap, seen, UNKNOWN)
    assert np.abs(start.values - [5.0, 0.3]).max() > 0.03
    found = correct(cheap, full, seen, start, max_runs=5)
    np.testing.assert_allclose(found.fit.values, [5.0, 0.3], atol=2e-3)
    assert found.runs[-1].misfit < 1e-2 * found.runs[0].misfit
    assert 2 <= len(found.runs) <= 5


class Swing(Line):
    """A swing whose frequency is that of √E; the better model is stiffer by `factor`."""

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def _phase(self, values):
        return 30.0 * np.sqrt(self.factor * 10 ** (values[0] - 5.0)) * np.arange(12) / 24.0

    def positions(self, values):
        return np.stack([np.cos(self._phase(values)), values[1] * np.ones(12), np.zeros(12)], -1)[:, None]

    def linearise(self, values):
        phase = self._phase(values)
        by_modulus = np.stack([-np.sin(phase) * phase * 0.5 * np.log(10), 0 * phase, 0 * phase], -1)
        by_ratio = np.broadcast_to([0.0, 1.0, 0.0], (12, 3))
        return self.positions(values), np.stack([by_modulus, by_ratio], 1)[:, :, None]


def test_a_full_model_out_of_phase_is_aligned_first():
    """At the reduced model's E the full one swings more than a third of a period off after the observed time."""
    from physconvex.identify import MarkerObservations

    cheap, full = Swing(1.0), Swing(0.6)
    truth = np.array([5.2, 0.3])
    seen = MarkerObservations(np.zeros((1, 3)), full.positions(truth), np.full((12, 1), 0.01))
    start = fit(cheap, seen, [replace(UNKNOWN[0], start=5.0), UNKNOWN[1]])
    assert start.values[0] == pytest.approx(5.2 + np.log10(0.6), abs=1e-3)
    phases = [full._phase(values)[-1] for values in (start.values, truth)]
    assert phases[1] - phases[0] > 2 * np.pi / 3
    found = correct(cheap, full, seen, start, max_runs=4)
    np.testing.assert_allclose(found.fit.values, truth, atol=1e-3)


def test_the_full_model_carries_the_same_points_in_the_same_world(box_twin, seen):
    """In flight the two models agree; floor, contact and damping are the same."""
    names, values = ("log10_youngs_modulus", "damping_time"), np.array([4.0, 2e-3])
    slow = box_twin.with_scene(initial_velocity=(0.2, 0.0, -0.1))  # it does not touch the floor in one frame
    full = FullModel(slow, names, seen.points, 2).positions(values)
    reduced = ReducedModel(slow, names, seen.points, 2).positions(values)
    np.testing.assert_allclose(full, reduced, atol=1e-6)
    assert np.linalg.norm(full[1] - full[0], axis=-1).min() > 0.004
    twin = box_twin.with_values(names, values)
    scene = twin.full_scene()
    assert scene.obstacles == twin.scene.obstacles and scene.damping_time == 2e-3
    assert scene.contact().stiffness == twin.scene.contact().stiffness
    assert scene.body.youngs_modulus == pytest.approx(1e4)


def test_names_and_bounds_are_checked(model, seen):
    with pytest.raises(InputError, match="expected those of the model"):
        fit(model, seen, UNKNOWN, options=FitOptions())
    with pytest.raises(InputError, match="expected one of"):
        default_parameter("colour")
    with pytest.raises(InputError, match="expected a value in"):
        Parameter("poisson_ratio", 0.6, 0.0, 0.495)
