"""Each effect does what its name says, in the full-order and in the reduced model."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex import InputError
from physconvex.dynamics import Timing, simulate
from physconvex.fem import SurfacePoints
from physconvex.gap import (
    DEFAULT_EFFECTS,
    EFFECT_NAMES,
    Dose,
    Effect,
    MotionCorrection,
    PointMotion,
    applicable,
    choose,
    diagnose,
)

NAMES = (
    "damping air_drag friction restitution gravity_tilt initial_velocity initial_spin plasticity viscoelasticity "
    "heterogeneity anisotropy nonlinear_elasticity wind camera_pose focal_length lens_distortion rolling_shutter "
    "motion_blur exposure time_scale time_offset reduction time_step mesh_resolution contact_stiffness"
).split()
TIMING = Timing(frames=13, fps=120.0, steps_per_frame=4)
SPAN = 12 / 120


def effect(label):
    return next(e for e in DEFAULT_EFFECTS if e.label == label)


def run(scene):
    """Centre of mass [T, 3], its velocity, and heights and lengths of the body, by either model."""
    if hasattr(scene.body, "mesh"):
        motion, masses = simulate(scene, TIMING), scene.body.node_masses
        points, velocities = motion.positions, motion.velocities
        weights = masses / masses.sum()
        return weights @ points, weights @ velocities, np.ptp(points, axis=1)
    motion, rest = simulate(scene, TIMING), scene.body.space.samples.surface_points
    points = motion.positions(rest)
    weights = scene.body.first_moments / scene.body.total_mass
    return weights @ motion.coordinates, weights @ motion.velocities, np.ptp(points, axis=1)


@pytest.fixture(scope="module", params=["full", "reduced"])
def scene(request, falling, falling_reduced):
    return falling if request.param == "full" else falling_reduced


@pytest.fixture(scope="module")
def plain(scene):
    return run(scene)


def test_every_name_is_there():
    assert set(NAMES) <= set(EFFECT_NAMES)
    assert all(e.source == "gauge" for e in DEFAULT_EFFECTS if e.name in ("density", "scale"))


def test_gauges_are_never_tried(situation):
    assert not {"density", "scale"} & {e.name for e in applicable(DEFAULT_EFFECTS, situation)}


def test_absent_at_the_null_dose(scene, plain):
    for one in DEFAULT_EFFECTS:
        if one.scene is not None and one.name in ("friction", "anisotropy", "plasticity", "wind", "viscoelasticity"):
            assert one.scene(scene, one.null) is scene or one.name == "friction"
    still = run(effect("friction").scene(scene, np.zeros(1)))
    np.testing.assert_allclose(still[0], plain[0], atol=1e-9)


def changed(scene, label, *doses):
    return run(effect(label).scene(scene, np.array(doses)))


def test_friction_slows_sliding(scene, plain):
    rough = changed(scene, "friction", 0.3)
    assert rough[1][-1, 0] < plain[1][-1, 0] - 0.05
    assert rough[1][-1, 0] > -0.1


def test_tilt_wind_velocity_push_to_their_side(scene, plain):
    tilted = changed(scene, "gravity_tilt", 5.0, 0.0)
    sideways = tilted[1][-1] - plain[1][-1]
    assert np.hypot(*sideways[:2]) > 0.05
    windy = changed(scene, "wind", 0.0, 15.0)
    assert windy[1][-1, 1] > plain[1][-1, 1] + 0.003
    pushed = changed(scene, "initial_velocity", 0.0, 0.2, 0.0)
    assert pushed[0][-1, 1] - plain[0][-1, 1] == pytest.approx(0.2 * SPAN, rel=0.02)


def test_spin_turns(falling):
    spun = effect("initial_spin").scene(falling, np.array([0.0, 0.0, 2.0]))
    velocity = spun.start_velocities() - falling.start_velocities()
    end = falling.start[:, 0].argmax()
    assert velocity[end, 1] == pytest.approx(2.0 * (falling.start[end, 0] - falling.start[:, 0].mean()), rel=0.1)


def test_drag_slows_flight(scene):
    high = effect("initial_velocity").scene(scene, np.array([0.0, 0.0, 4.0]))  # flies up: no contact
    free = run(high)
    for label, dose in (("air_drag (linear)", 1.0), ("air_drag (quadratic)", 40.0)):
        slowed = run(effect(label).scene(high, np.array([dose])))
        assert slowed[1][-1, 2] < free[1][-1, 2] - 0.05
        assert 0 < slowed[1][-1, 0] < free[1][-1, 0]


def test_dissipation_lowers_the_rebound(scene, plain):
    rebound = plain[1][:, 2].max()
    assert rebound > 0.5
    for label, doses in (
        ("damping", (3e-3,)),
        ("restitution", (0.02,)),
        ("plasticity", (3.0,)),
        ("viscoelasticity (fast)", (1.0, -2.2)),
    ):
        assert changed(scene, label, *doses)[1][:, 2].max() < rebound - 0.02, label


def test_a_yield_stress_that_nothing_reaches_changes_nothing(scene, plain):
    for found, expected in zip(changed(scene, "plasticity", 8.0), plain, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-7)


@pytest.mark.parametrize(
    ("label", "doses"),
    [
        ("viscoelasticity (fast)", (1.0, -2.2)),
        ("anisotropy (z)", (3.0, 0.0, 0.0)),
        ("nonlinear_elasticity (stiffening)", (5.0,)),
    ],
)
def test_plastic_bodies_relax_stiffen_and_have_fibres(scene, label, doses):
    """Whichever effect is put in first; what was added to the law of a plastic body had vanished without a word."""
    plastic, other = effect("plasticity"), effect(label)
    yields, doses = np.array([2.8]), np.array(doses)
    one = run(other.scene(plastic.scene(scene, yields), doses))
    another = run(plastic.scene(other.scene(scene, doses), yields))
    for a, b in zip(one, another, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)
    alone = run(plastic.scene(scene, yields)), run(other.scene(scene, doses))
    assert all(np.abs(one[2] - without[2]).max() > 3e-4 for without in alone)


def test_plastic_bodies_have_no_share_of_another_law(scene):
    plastic, other = effect("plasticity"), effect("nonlinear_elasticity (softening)")
    yields, share = np.array([2.8]), np.array([0.5])
    with pytest.raises(InputError, match="of a plastic body"):
        other.scene(plastic.scene(scene, yields), share)
    with pytest.raises(InputError, match="of a plastic body"):
        plastic.scene(other.scene(scene, share), yields)


def test_stiffening_shortens_the_squeeze(scene, plain):
    squeezed = plain[2][:, 2].min()
    for label, doses in (("nonlinear_elasticity (stiffening)", (5.0,)), ("anisotropy (z)", (3.0, 0.0, 0.0))):
        assert changed(scene, label, *doses)[2][:, 2].min() > squeezed + 5e-4, label


def test_saint_venant_and_kirchhoff_lengthen_the_squeeze(scene, plain):
    squeezed = changed(scene, "nonlinear_elasticity (softening)", 0.5)[2][:, 2].min()
    assert squeezed < plain[2][:, 2].min() - 5e-4


def added_mass(scene, loaded):
    """What a load adds [kg], and its mean place along x from the end at +x, over the length, by either model."""
    if loaded.body is scene.body:  # on the nodes of the full-order model
        x, masses = scene.body.mesh.vertices[:, 0], loaded.hanging_masses
        return masses.sum(), (x.max() - masses @ x / masses.sum()) / np.ptp(x)
    x = scene.body.space.samples.surface_points[:, 0]
    moments = [s.body.total_mass * run(s)[0][0, 0] for s in (scene, loaded)]
    mass = loaded.body.total_mass - scene.body.total_mass
    return mass, (x.max() - (moments[1] - moments[0]) / mass) / np.ptp(x)


def test_attached_mass_is_at_its_end(scene):
    loads = [effect("attached_mass (+x)").scene(scene, np.array([0.5, inset])) for inset in (0.0, 0.3)]
    (mass, near), (same, farther) = [added_mass(scene, load) for load in loads]
    assert mass == pytest.approx(0.5 * scene.body.total_mass, rel=1e-9) and same == pytest.approx(mass, rel=1e-9)
    if loads[0].body is scene.body:  # nodes lie at the very end
        assert near < 1e-3 and farther == pytest.approx(0.3, abs=1e-6)
    assert 0 <= near < 0.15 and farther - near == pytest.approx(0.3, abs=0.12)  # few cells
    high = np.array([0.0, 0.0, 4.0])  # no contact
    bare, loaded = [run(effect("initial_velocity").scene(one, high))[1] for one in (scene, loads[0])]
    np.testing.assert_allclose(loaded, bare, atol=2e-2)  # it is thrown too, and falls as fast


def test_attached_mass_with_contact_on_the_surface_is_in_the_cells(falling):
    on_surface = replace(falling, contact_points=SurfacePoints.of_triangles(*falling.body.mesh.surface))
    loaded = effect("attached_mass (+x)").scene(on_surface, np.array([0.5, 0.0]))
    assert loaded.hanging is None and loaded.body.total_mass == pytest.approx(1.5 * falling.body.total_mass)
    with pytest.raises(InputError, match="contact_points"):
        effect("attached_mass (+x, loose)").scene(on_surface, np.array([0.5, 0.0, 0.01]))


def test_attached_mass_is_for_held_bodies(situation):
    assert "attached_mass" not in {e.name for e in applicable(DEFAULT_EFFECTS, situation)}
    assert "attached_mass" in {e.name for e in applicable(DEFAULT_EFFECTS, replace(situation, clamped=True))}


def test_soft_contact_sinks_deeper(scene, plain):
    soft = changed(scene, "contact_stiffness", -1.5)
    assert soft[0][:, 2].min() < plain[0][:, 2].min() - 5e-4


def test_uneven_stiffness_keeps_contact_and_mean(falling):
    uneven = effect("heterogeneity").scene(falling, np.array([0.3, 0.0, 0.0, 0.0]))
    centres = falling.body.mesh.vertices[falling.body.mesh.corner_tets].mean(1)
    ratio = (uneven.body.youngs_modulus / falling.body.youngs_modulus[:, None]).mean(1)
    assert ratio[centres[:, 0].argmax()] > 1.1 and ratio[centres[:, 0].argmin()] < 0.9
    assert uneven.contact().stiffness == falling.contact().stiffness


def test_an_inclusion_is_stiffer_about_its_centre(falling):
    inside = np.array([0.5, 0.5, -0.5])
    uneven = effect("heterogeneity (inclusion, +x+y-z)").scene(falling, np.array([0.4, *inside]))
    x = falling.body.quadrature_points.reshape(-1, 3)
    low, high = falling.body.mesh.vertices.min(0), falling.body.mesh.vertices.max(0)
    distance = np.linalg.norm(2 * (x - low) / (high - low) - 1 - inside, axis=1)
    ratio = (uneven.body.youngs_modulus / falling.body.youngs_modulus[:, None]).ravel()
    assert ratio == pytest.approx(10 ** (0.4 * np.exp(-2 * distance**2)))


def motion_of(points=5):
    times = np.arange(12) / 50.0
    rest = np.random.default_rng(1).normal(size=(points, 3))
    t, along, down = times[:, None, None], np.array([1.0, 0, 0]), np.array([0, 0, -1.0])
    positions = rest + along * t + 4.9 * down * t**2
    velocities = np.broadcast_to(along, positions.shape) + 9.8 * down * t
    return PointMotion(rest, times, positions, velocities)


def test_clocks():
    motion = motion_of()
    late = effect("time_offset").observe(motion, np.array([0.004]))
    expected = motion.positions + 0.004 * motion.velocities - 4.9 * np.array([0, 0, 0.004**2])
    np.testing.assert_allclose(late[:-1], expected[:-1], atol=1e-12)
    fast = effect("time_scale").observe(motion, np.array([0.01]))
    np.testing.assert_allclose(fast[:, :, 0] - motion.rest[:, 0], 1.01 * motion.times[:, None] * np.ones(5), atol=1e-12)


def test_times_of_single_points():
    motion = motion_of()
    times = motion.times[:, None] + np.linspace(0, 0.002, 5)
    moved = motion.at(times)
    np.testing.assert_allclose(moved[3, :, 0] - motion.rest[:, 0], times[3], atol=1e-12)


def bouncing(times):
    """A point that falls, is thrown back at t = .101 s within a thousandth of a second, and its velocity."""
    hit = np.clip(times - 0.101, 0.0, None)
    turn = np.clip(hit / 1e-3, 0.0, 1.0)
    height = 1.0 - times + np.where(hit < 1e-3, 1e3 * hit**2, 2 * hit - 1e-3)
    along = np.array([0.0, 0.0, 1.0])
    return height[:, None, None] * along, (2 * turn - 1)[:, None, None] * along


def test_between_frames_and_beyond_them_steps_tell_where_points_are():
    times, fine = np.arange(13) / 50.0, np.arange(13 * 40) / 2000.0
    steps = PointMotion(np.zeros((1, 3)), fine, *bouncing(fine))
    motion = PointMotion.of_steps(steps, len(times), 40)
    np.testing.assert_array_equal(motion.positions, bouncing(times)[0])
    for other in (times + 0.007, times * 1.05):
        np.testing.assert_allclose(motion.at(other), bouncing(other)[0], atol=1e-4)
        np.testing.assert_allclose(motion.at(other[:, None])[:, 0], bouncing(other)[0][:, 0], atol=1e-4)
    blind = PointMotion(motion.rest, motion.times, motion.positions, motion.velocities)
    assert np.abs(blind.at(times + 0.007) - bouncing(times + 0.007)[0]).max() > 1e-3
    assert motion.first(4).end == motion.end > 0.25 and blind.end == times[-1]


def test_what_corrects_a_motion_goes_with_its_time():
    times, fine = np.arange(13) / 50.0, np.arange(13 * 40) / 2000.0
    motion = PointMotion.of_steps(PointMotion(np.zeros((1, 3)), fine, *bouncing(fine)), len(times), 40)
    moved = replace(motion, positions=motion.positions + 0.1 * times[:, None, None])
    late = np.clip(times + 0.007, 0.0, times[-1])  # and is held beyond the last frame
    np.testing.assert_allclose(
        moved.at(times + 0.007) - motion.at(times + 0.007), 0.1 * late[:, None, None] + 0 * moved.positions, atol=1e-9
    )


def test_what_a_cheaper_model_lacks_is_known_between_frames_too():
    """A body that the finer model throws back with half the speed: before it strikes, nothing is lacking."""
    times, fine = np.arange(13) / 50.0, np.arange(13 * 40) / 2000.0

    def rolled(share):
        height, speed = bouncing(fine)
        hit = fine > 0.1015
        low = height[hit][0] if share < 1 else 0.0
        height = np.where(hit[:, None, None], low + share * (height - low), height)
        speed = np.where(hit[:, None, None], share * speed, speed)
        return PointMotion.of_steps(PointMotion(np.zeros((1, 3)), fine, height, speed), len(times), 40)

    own, exact = rolled(1.0), rolled(0.5)
    corrected = MotionCorrection.between(exact, own).of(own)
    np.testing.assert_allclose(corrected.positions, exact.positions, atol=1e-12)
    np.testing.assert_allclose(corrected.at(times * 1.05), exact.at(times * 1.05), atol=1e-12)
    by_frames = MotionCorrection(exact.positions - own.positions).of(own)
    assert np.abs(by_frames.at(times - 0.01) - exact.at(times - 0.01)).max() > 5e-4
    further = PointMotion(own.rest, fine, own.steps.positions, own.steps.velocities)
    shorter = replace(exact, steps=exact.steps.first(481))  # which ends with the last frame
    late = MotionCorrection.between(shorter, own).of(PointMotion.of_steps(further, len(times), 40))
    np.testing.assert_allclose(late.at(times + 0.015), exact.at(times + 0.015), atol=1e-12)  # straight on


@pytest.mark.parametrize(
    ("name", "dose", "ahead"),
    [
        ("time_offset", 0.01, 0.01),
        ("time_scale", 0.1, 0.05),
        ("time_scale", -0.1, 0.0),
        ("rolling_shutter", -0.02, 0.01),
    ],
)
def test_how_far_clocks_look_beyond_the_last_frame(name, dose, ahead):
    assert max(effect(name).ahead(0.5, np.array([dose])), 0.0) == pytest.approx(ahead)


def test_pose_is_rigid():
    motion = motion_of()
    turned = effect("camera_pose").observe(motion, np.array([1.0, 2.0, 3.0, 0.1, 0.0, 0.0]))
    distance = np.linalg.norm(motion.positions[:, 0] - motion.positions[:, 1], axis=-1)
    np.testing.assert_allclose(np.linalg.norm(turned[:, 0] - turned[:, 1], axis=-1), distance, atol=1e-12)
    assert np.abs(turned - motion.positions).max() > 0.05


def test_signs():
    assert effect("damping").doses[0].sign == 1
    assert effect("plasticity").doses[0].sign == -1  # it can only yield sooner
    assert effect("gravity_tilt").doses[0].sign == 0


def test_a_typical_step_to_a_threshold_is_no_longer_than_the_effect_s_reach(situation):
    """It was as long as from where nothing yields, 4 decades: derivatives over .4, and a fit of a yield stress lost."""
    doses = {dose.name: dose for effect in reversed(DEFAULT_EFFECTS) for dose in effect.doses}
    assert doses["log10_yield_stress"].step(situation) == 0.1
    assert doses["damping_time"].step(situation) == pytest.approx(0.05 * situation.wave_time)
    assert doses["log10_relaxation_time"].step(situation) == pytest.approx(0.2)


def test_dose_estimates():
    linear, threshold = effect("damping").doses[0], effect("plasticity").doses[0]
    assert linear.estimate(2.0, 0.5, 1e-3) == (2e-3, 5e-4)
    assert linear.estimate(1e9, 1.0, 1e-3)[0] == linear.upper
    assert threshold.estimate(1.0, 0.1, 4.0)[0] == pytest.approx(4.0)
    assert threshold.estimate(0.25, 0.1, 4.0)[0] == pytest.approx(4.0 + np.log10(2))  # weaker: yields later
    assert threshold.slope(4.0) < 0 < linear.slope(1e-3)


def test_own_effect(situation):
    push = Effect("magnet", "external", (Dose("pull", "m/s²", 0, 5, 0.1, lambda s: 0.2),), scene=lambda scene, d: scene)
    assert push in choose(extra=[push]) and push not in choose()
    assert [index for index, _ in push.trials(situation)] == [0]
    with pytest.raises(InputError, match="no_such_effect"):
        choose(["no_such_effect"])
    with pytest.raises(InputError, match="none is left"):
        choose(["damping"], without=["damping"])
    with pytest.raises(InputError, match="acts on nothing"):
        Effect("ghost", "material", (Dose("x", "", 0, 1, 0.1, lambda s: 0.1),))


def test_a_second_take_that_is_not_there_is_refused_at_once(monkeypatch, tmp_path):
    monkeypatch.setattr("physconvex.gap.diagnosis.rough_baseline", lambda *_, **__: pytest.fail("it began"))
    with pytest.raises(InputError, match="nothere"):
        diagnose("examples/captures/silicone_beam_gravity", second_take=tmp_path / "nothere")
