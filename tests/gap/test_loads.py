"""A load at the free end of a held body is found together with E, which alone would be far off."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.gap import (
    DEFAULT_EFFECTS,
    GapOptions,
    MotionCorrection,
    applicable,
    error_model,
    fit_baseline,
    rough_baseline,
)
from physconvex.gap.errors.numerical_differences import Numerics
from physconvex.gap.search.full_order import as_reduced
from physconvex.gap.search.starting_points import _clock, loaded_starts
from physconvex.io import Capture, save_capture

MODULUS = 2e5  # of the fixture `released`
Released = Callable[[Path, float], Capture]
OPTIONS = GapOptions(max_nodes=100, weights=4, iterations=6)


def starts(
    capture: Capture, *beside: tuple[str, list[float]]
) -> tuple[list[tuple[tuple[str, ...], np.ndarray]], float]:
    """Labels and values, and E of the base fit; the latter with effects at given doses."""
    rough = rough_baseline(capture, OPTIONS, lambda text: None)
    still = np.zeros_like(rough.motion.positions)
    variance = np.ones(len(rough.residual(rough.positions)))
    base = as_reduced(
        fit_baseline(rough, MotionCorrection(still), None, variance, options=OPTIONS, report=lambda text: None)
    )
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
def test_a_load_is_found_with_its_modulus(released: Released, tmp_path: Path) -> None:
    found, alone = starts(released(tmp_path, 0.8))
    assert [labels for labels, _ in found] == [
        ("attached_mass (-x)", "damping"), ("attached_mass (-x)",), ("attached_mass (-x, loose)", "damping"),
    ]  # fmt: skip
    modulus, ratio = found[1][1][[0, 2]]
    assert modulus == pytest.approx(np.log10(MODULUS), abs=0.15) and 0.4 <= ratio <= 1.6
    assert alone < np.log10(MODULUS) - 0.2  # a fit without the load is far off


@pytest.mark.slow
def test_a_load_is_found_beside_another_effect(released: Released, tmp_path: Path) -> None:
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
def test_none_is_begun_with_where_there_is_none(released: Released, tmp_path: Path) -> None:
    assert starts(released(tmp_path, 0.0))[0] == []


def test_without_the_effect_there_is_nothing_to_begin_with(released: Released, tmp_path: Path) -> None:
    rough = rough_baseline(released(tmp_path, 0.8), OPTIONS.replace(max_nodes=60), lambda text: None)
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
