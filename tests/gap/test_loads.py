"""A load at the free end of a held body is found together with E, which alone would be far off."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.capture import Boundary, Capture, Tracks, save_capture
from physconvex.fem import ElasticBody, HangingLoad, Pins, Scene, TetMesh, box_mesh, simulate
from physconvex.gap import DEFAULT_EFFECTS, GapOptions
from physconvex.gap.base.base_fit import fit_baseline, rough_baseline
from physconvex.gap.effects import applicable
from physconvex.gap.errors.numerics import Numerics, error_model
from physconvex.gap.search.loads import _clock, loaded_starts
from physconvex.gap.search.mapping import as_reduced

MODULUS, SIGMA, FPS, FRAMES = 2e5, 5e-5, 80.0, 30
OPTIONS = GapOptions(max_nodes=100, weights=4, iterations=6)


def released(folder: Path, ratio: float) -> Capture:
    """A beam that is held at its right end and let go, a load of so many of its own masses at its left end."""
    mesh = box_mesh((0.12, 0.03, 0.03), (8, 1, 1), order=2)
    corners = box_mesh((0.12, 0.03, 0.03), (8, 1, 1), order=1)
    body = ElasticBody(mesh, youngs_modulus=MODULUS, poisson_ratio=0.4, density=1000.0)
    x = mesh.vertices[:, 0]
    end, held = x < x.min() + 1e-9, np.flatnonzero(x > x.max() - 1e-9)
    load = HangingLoad(np.where(end, ratio * body.total_mass / end.sum(), 0.0)) if ratio else None
    run = simulate(Scene(body, pins=Pins(held), hanging=load), frames=FRAMES, fps=FPS, steps_per_frame=8)
    shown = np.flatnonzero(x < x.min() + 0.06)[::5]
    positions = run.positions[:, shown] + SIGMA * np.random.default_rng(1).normal(size=(FRAMES, len(shown), 3))
    capture = Capture(folder / "capture", FPS, FRAMES, 20, gravity=np.array([0.0, 0.0, -9.81]), density=1000.0)
    box = np.array([[x.max() - 1e-4, -1.0, -1.0], [x.max() + 1e-4, 1.0, 1.0]])
    tracks = Tracks(mesh.vertices[shown], positions, np.full(positions.shape[:2], SIGMA))
    save_capture(
        capture, tets=TetMesh(corners.vertices, corners.tets), tracks=tracks, boundary=Boundary(clamped_box=box)
    )
    return capture


def starts(
    capture: Capture, *beside: tuple[str, list[float]]
) -> tuple[list[tuple[tuple[str, ...], np.ndarray]], float]:
    """Labels and values, and E of the base fit; the latter with effects at given doses."""
    rough = rough_baseline(capture, OPTIONS, lambda text: None)
    still = np.zeros_like(rough.motion.positions)
    variance = np.ones(len(rough.residual(rough.positions)))
    base = as_reduced(fit_baseline(rough, still, None, variance, OPTIONS, lambda text: None))
    errors = error_model(base, Numerics(still, still, still, still, still), OPTIONS)
    alone = base.fit.values
    known = {effect.label: effect for effect in DEFAULT_EFFECTS}
    if beside:
        model = replace(base.model, effects=tuple(known[name] for name, _ in beside))
        values = np.concatenate([alone, *(doses for _, doses in beside)])
        base = replace(base, model=model, fit=replace(base.fit, parameters=model.parameters(values), values=values))
    found = loaded_starts(base, errors, applicable(DEFAULT_EFFECTS, base.situation))
    return [(tuple(e.label for e in effects), values) for effects, values in found], alone[0]


@pytest.mark.slow
def test_a_load_is_found_with_its_modulus(tmp_path: Path) -> None:
    found, alone = starts(released(tmp_path, 0.8))
    assert [labels for labels, _ in found] == [
        ("attached_mass (-x)", "damping"), ("attached_mass (-x)",), ("attached_mass (-x, loose)", "damping"),
    ]  # fmt: skip
    modulus, ratio = found[1][1][[0, 2]]
    assert modulus == pytest.approx(np.log10(MODULUS), abs=0.15) and 0.4 <= ratio <= 1.6
    assert alone < np.log10(MODULUS) - 0.2  # a fit without the load is far off


@pytest.mark.slow
def test_a_load_is_found_beside_another_effect(tmp_path: Path) -> None:
    """Markers in another frame: without that effect the shift would count as sag."""
    capture = released(tmp_path, 0.8)
    tracks = capture.tracks()
    assert tracks is not None
    moved = replace(tracks, positions=tracks.positions + np.array([0.0, 0.0, 0.01]))
    save_capture(
        replace(capture, folder=tmp_path / "moved"), tets=capture.tets(), tracks=moved, boundary=capture.boundary()
    )
    found, _ = starts(replace(capture, folder=tmp_path / "moved"), ("camera_pose", [0.0, 0.0, 0.0, 0.0, 0.0, 0.01]))
    labels, values = found[1]
    assert labels == ("camera_pose", "attached_mass (-x)")
    modulus, shift, ratio = values[[0, 7, 8]]
    assert modulus == pytest.approx(np.log10(MODULUS), abs=0.15) and 0.4 <= ratio <= 1.6 and shift == 0.01


@pytest.mark.slow
def test_none_is_begun_with_where_there_is_none(tmp_path: Path) -> None:
    assert starts(released(tmp_path, 0.0))[0] == []


def test_without_the_effect_there_is_nothing_to_begin_with(tmp_path: Path) -> None:
    rough = rough_baseline(released(tmp_path, 0.8), replace(OPTIONS, max_nodes=60), lambda text: None)
    errors = error_model(rough, Numerics(*[np.zeros_like(rough.motion.positions)] * 5), OPTIONS)
    assert loaded_starts(rough, errors, [e for e in DEFAULT_EFFECTS if e.name != "attached_mass"]) == []


@pytest.mark.wrong_types
def test_the_clock_of_the_recording_counts() -> None:
    clock = next(e for e in DEFAULT_EFFECTS if e.name == "time_scale")
    load = next(e for e in DEFAULT_EFFECTS if e.label == "attached_mass (-x)")
    model = SimpleNamespace(effects=(load, clock), slices=(slice(2, 4), slice(4, 5)))
    base = SimpleNamespace(model=model, fit=SimpleNamespace(values=np.array([5.0, 0.4, 0.3, 0.0, 0.05])))
    assert _clock(base) == pytest.approx(1.05)
    assert _clock(SimpleNamespace(model=SimpleNamespace(effects=(), slices=()), fit=None)) == 1.0
