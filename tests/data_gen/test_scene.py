"""Random drops and looks: ranges kept, streams independent, the path in view; configuration read and refused."""

import numpy as np
import pytest
import trimesh

from data_gen import GeneratorConfig, draw_drop, draw_look, load_config, random_stream
from data_gen.config import Interval
from data_gen.scene import split_of
from physconvex import InputError


@pytest.fixture(scope="module")
def config() -> GeneratorConfig:
    return load_config()


@pytest.fixture(scope="module")
def drops(config):
    return [draw_drop(config, 7, number, 0) for number in range(4)]


def test_drops_keep_the_configured_ranges(config, drops):
    for drop in drops:
        assert 1e4 <= drop.youngs_modulus <= 1e7 and 0.2 <= drop.poisson_ratio <= 0.49
        assert drop.density == 1000.0 and 5e-4 <= drop.damping_time <= 2e-3 and 0.2 <= drop.friction <= 1.0
        assert np.linalg.norm(drop.initial_velocity) <= 0.5 and np.linalg.norm(drop.initial_angular_velocity) <= 2.0
        placed = drop.placed(drop.body.vertices)
        assert drop.size == pytest.approx(np.ptp(placed, axis=0).max())
        assert 0.5 <= drop.body.size <= 1.5 + 1e-9
        assert 0.3 - 1e-9 <= placed[:, 2].min() / drop.body.size <= 1.5 + 1e-9
        np.testing.assert_allclose(drop.rotation @ drop.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(drop.rotation) == pytest.approx(1)


def test_a_drop_depends_on_seed_number_and_attempt_alone(config, drops):
    again = draw_drop(config, 7, 2, 0)
    assert again.youngs_modulus == drops[2].youngs_modulus and again.object_id == drops[2].object_id
    np.testing.assert_array_equal(again.body.vertices, drops[2].body.vertices)
    other = draw_drop(config, 8, 2, 0)
    assert other.youngs_modulus != again.youngs_modulus and other.object_id != again.object_id
    replaced = draw_drop(config, 7, 2, 1)
    assert replaced.youngs_modulus != again.youngs_modulus and replaced.object_id != again.object_id


def test_simulations_of_one_object_share_it_but_not_the_material(drops):
    assert drops[0].object_id == drops[1].object_id != drops[2].object_id == drops[3].object_id
    assert drops[0].youngs_modulus != drops[1].youngs_modulus


def test_materials_have_the_stated_distribution(config):
    # Means of uniform variables; tolerance: four standard errors of 2,000 draws.
    rng = random_stream(0, 99)
    log_modulus = np.log10([config.material.youngs_modulus.sample(rng) for _ in range(2000)])
    assert log_modulus.mean() == pytest.approx(5.5, abs=4 * 3 / np.sqrt(12 * 2000))
    assert log_modulus.min() >= 4 and log_modulus.max() <= 7
    poisson = [config.material.poisson_ratio.sample(rng) for _ in range(2000)]
    assert np.mean(poisson) == pytest.approx(0.345, abs=4 * 0.29 / np.sqrt(12 * 2000))


def test_splits_are_by_object_and_of_the_asked_shares():
    names = [f"object-{k}" for k in range(5000)]
    splits = np.array([split_of(name, 0.8, 0.08) for name in names])
    for split, share in (("train", 0.8), ("validation", 0.08), ("test", 0.12)):
        # four standard deviations of a binomial share
        assert (splits == split).mean() == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / 5000))
    assert split_of("object-3", 0.8, 0.08) == splits[3]


def test_whole_path_is_in_view_and_lit_from_above(config):
    rng = np.random.default_rng(3)
    start = rng.uniform(-0.5, 0.5, (40, 3)) + np.array([0, 0, 2.0])
    path = np.stack([start - [0.2 * t, 0, 1.5 * t**2] for t in np.linspace(0, 1, 8)])
    distances = []
    for number in range(20):
        look = draw_look(config, random_stream(1, 5, number), path, name="front")
        pixels, depth = look.camera.project(path.reshape(-1, 3))
        assert (depth > 0).all() and pixels.min() >= 0 and pixels.max() <= 128
        assert np.linalg.norm(look.lighting.direction) == pytest.approx(1) and look.lighting.direction[2] > 0.5
        assert look.camera.position[2] > 0
        # The key light stands on the camera's side, else the object would be dark.
        towards = look.camera.position - path.reshape(-1, 3).mean(axis=0)
        assert np.dot(towards[:2], look.lighting.direction[:2]) > 0
        distances.append(np.linalg.norm(towards))
    assert np.ptp(distances) > 0.5


def test_azimuth_may_be_prescribed(config):
    path = np.array([[[0.0, 0, 0.5], [0.1, 0, 1.0]]])
    for degrees, side in ((0, [0, -1]), (90, [-1, 0]), (180, [0, 1])):
        position = draw_look(config, random_stream(0, 1), path, name="ring", azimuth_deg=degrees).camera.position[:2]
        assert position @ side / np.linalg.norm(position) > 0.95


def test_user_meshes_replace_the_procedural_bodies(tmp_path):
    trimesh.creation.box(extents=(1, 2, 3)).export(tmp_path / "box.ply")
    config = load_config(overrides=[f"objects.folder={tmp_path}", "motion.orientation=given", "motion.size=0.9"])
    drop = draw_drop(config, 0, 0, 0)
    assert drop.family == "user" and "box" in drop.object_id
    np.testing.assert_allclose(np.ptp(drop.placed(drop.body.vertices), axis=0), [0.3, 0.6, 0.9])


def test_ranges_are_read_from_numbers_pairs_and_tables(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(
        "material: {density: 900, poisson_ratio: [0.3, 0.4]}\nmotion: {size: {low: 1, high: 2, scale: log}}"
    )
    config = load_config(file, overrides=["camera.views=1", "video.fps=30"])
    assert config.material.density == Interval(low=900, high=900)
    assert config.material.poisson_ratio == Interval(low=0.3, high=0.4)
    assert config.motion.size.scale == "log" and config.camera.views == 1 and config.video.fps == 30.0
    assert GeneratorConfig.model_validate(config.model_dump(mode="json")) == config


@pytest.mark.parametrize("preset", ["training", "clean", "captures"])
def test_presets_are_valid(preset):
    assert load_config(preset).video.frames == 24


@pytest.mark.parametrize(
    "override, words",
    [
        ("material.poisson_ratio=[0.4,0.3]", "poisson_ratio"),
        ("material.poisson_ratio=0.5", "inside"),
        ("motion.size={low: 0, high: 1, scale: log}", "positive"),
        ("motion.mass=1", "mass"),
        ("video.width=63", "multiple of 2"),
        ("views", "section.name=value"),
        ("material.law=[", "YAML"),
    ],
)
def test_bad_settings_are_named(override, words):
    with pytest.raises(InputError, match=words):
        load_config(overrides=[override])


def test_unknown_preset_lists_the_known_ones():
    with pytest.raises(InputError, match="training"):
        load_config("no_such_preset")
