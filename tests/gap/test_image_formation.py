"""Pictures of a textured square that moves before a still background: exposure and shutter are told from them alone."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from physconvex.gap import DEFAULT_EFFECTS, GapOptions, NamedEffect, Patches, Verdict
from physconvex.gap.light.image_formation import BRIGHTNESS, SMEAR, finding_of, with_pictures
from physconvex.gap.light.patches import body_patches, light_of, still_patches
from physconvex.gap.page.pictures import image_series
from physconvex.identify import PixelObservations
from physconvex.io import look_at

SIZE, SIDE, FPS, FRAMES, FALL = 160, 64, 24.0, 16, 0.6  # pixels; pixels per frame²
EXPOSURE, MOTION_BLUR = (next(e for e in DEFAULT_EFFECTS if e.name == n) for n in ("exposure", "motion_blur"))


def texture(rng, size):
    return np.clip(cv2.GaussianBlur(rng.uniform(-1.5, 2.5, (size, size)), (0, 0), 1.0), 0.05, 0.95)


def filmed(*, open_for=0.0, drift=0.0, noise=0.0, sideways=0.3, seed=0):
    """Video [T, H, W, 3], and the pixels of points of the square, which falls and goes sideways."""
    rng = np.random.default_rng(seed)
    background, square = texture(rng, SIZE), texture(rng, SIDE)
    square, background = 0.1 + 0.8 * square, 0.3 + 0.4 * background
    frames, subframes = [], 25 if open_for else 1
    for t in range(FRAMES):
        light = np.zeros((SIZE, SIZE))
        for part in np.linspace(-0.5, 0.5, subframes) * open_for * FPS if open_for else [0.0]:
            place = corner(t + part, sideways)
            warp = np.array([[1, 0, place[0]], [0, 1, place[1]]])
            cover = cv2.warpAffine(np.ones_like(square), warp, (SIZE, SIZE))
            moved = cv2.warpAffine(square, warp, (SIZE, SIZE), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
            light += (np.where(cover > 0, cover * moved + (1 - cover) * background, background)) / subframes
        grey = 255 * np.clip(light * np.exp(drift * t / FPS), 0, 1) ** (1 / 2.2) + rng.normal(
            0, 255 * noise, light.shape
        )
        frames.append(np.repeat(np.clip(grey + 0.5, 0, 255).astype(np.uint8)[..., None], 3, 2))
    grid = np.stack(np.meshgrid(np.arange(8, SIDE - 7, 9), np.arange(8, SIDE - 7, 9)), -1).reshape(-1, 2) + 0.5
    return np.stack(frames), np.stack([grid + corner(t, sideways) for t in range(FRAMES)])


def corner(t, sideways):
    return np.array([20.0 + sideways * t, 8.0 + 0.5 * FALL * t**2])


def patches_of(frames, pixels):
    """Of the background and of the square."""
    camera = look_at((0, -10, 0), (0, 0, 0), width=SIZE, height=SIZE, vertical_field_of_view=0.5, name="front")
    seen = PixelObservations(camera, np.zeros((pixels.shape[1], 3)), pixels, np.ones(pixels.shape[:2]))
    outline, (left, top) = np.zeros((SIZE, SIZE), dtype=bool), corner(0, 0).astype(int)
    outline[top : top + SIDE, left : left + SIDE] = True
    light = light_of(frames)
    return still_patches(light, seen, FPS, outline), body_patches(light, seen, FPS, outline)


@pytest.fixture
def camera_situation(situation):
    return replace(situation, fps=FPS, frames=FRAMES)


def findings(situation, frames, pixels):
    still, moving = patches_of(frames, pixels)
    pairs = (EXPOSURE, BRIGHTNESS, still), (MOTION_BLUR, SMEAR, moving)
    return [finding_of(effect, situation, statistic, x, GapOptions()) for effect, statistic, x in pairs]


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_nothing_is_called_of_sharp_even_pictures(camera_situation, noise):
    exposure, blur = findings(camera_situation, *filmed(noise=noise))
    assert not exposure.called
    assert not blur.called


@pytest.mark.parametrize("open_for", [0.5 / FPS, 0.8 / FPS])
def test_an_open_shutter_is_called_and_timed(camera_situation, open_for):
    exposure, blur = findings(camera_situation, *filmed(open_for=open_for, noise=0.005))
    assert blur.called
    assert not exposure.called
    assert blur.named.doses[0].value == pytest.approx(open_for, rel=0.15)
    assert blur.shrinkage > 0.8
    assert blur.placebo < 0.2


@pytest.mark.parametrize("drift", [-0.5, 0.3])
def test_a_drift_is_called_and_measured(camera_situation, drift):
    exposure, blur = findings(camera_situation, *filmed(drift=drift, noise=0.005))
    assert exposure.called
    assert not blur.called
    assert exposure.named.doses[0].value == pytest.approx(drift, rel=0.1)
    assert exposure.named.doses[0].lower <= drift <= exposure.named.doses[0].upper
    assert exposure.shrinkage > 0.9


def test_a_flicker_is_no_drift(camera_situation):
    frames, pixels = filmed()
    flickering = np.where((np.arange(FRAMES) % 4 < 2)[:, None, None, None], frames, 0.9 * frames).astype(np.uint8)
    assert not findings(camera_situation, flickering, pixels)[0].called


def test_an_effect_shows_in_its_own_statistic_alone(camera_situation):
    still, moving = patches_of(*filmed())
    assert finding_of(MOTION_BLUR, camera_situation, BRIGHTNESS, still, GapOptions()) is None
    assert finding_of(EXPOSURE, camera_situation, SMEAR, moving, GapOptions()) is None


def test_a_smear_keeps_the_light_and_widens_along_the_motion():
    light = np.zeros((1, 21, 21))
    light[0, 10, 10] = 1.0
    spread = MOTION_BLUR.photograph(Patches(light, np.array([[80.0, 0.0]]), np.zeros(1)), np.array([0.1]))[0]
    assert spread.sum() == pytest.approx(1.0)
    columns = np.arange(21) - 10.0
    assert (spread.sum(0) * columns).sum() == pytest.approx(0.0, abs=1e-12)
    assert (spread.sum(0) * columns**2).sum() == pytest.approx(8.0**2 / 12, rel=0.1)
    np.testing.assert_allclose(spread[[9, 11]], 0.0, atol=1e-12)


def test_derivatives_of_exposure():
    rng = np.random.default_rng(0)
    patches = Patches(rng.uniform(size=(3, 5, 5)), np.zeros((3, 2)), np.array([0.1, 0.2, 0.3]))
    ahead, behind = (EXPOSURE.photograph(patches, np.array([0.4 + x])) for x in (1e-5, -1e-5))
    here = EXPOSURE.photograph(patches, np.array([0.4]))
    np.testing.assert_allclose((ahead - behind) / 2e-5, here * patches.times[:, None, None], rtol=1e-6)


def verdict_of(name, *effects):
    return Verdict(name, f"The motion: {name}.", effects, 0.1, 0.9, ("A caveat.",))


def test_what_pictures_show_beside_the_verdict_on_the_motion(camera_situation):
    exposure, blur = findings(camera_situation, *filmed(drift=-0.5))
    found = with_pictures(verdict_of("none"), (exposure, blur))
    assert (found.name, [e.name for e in found.effects]) == ("effect", ["exposure"])
    assert "drift = -0.5 1/s" in found.sentence
    assert found.sentence.endswith("Of the motion: The motion: none.")
    other = NamedEffect("wind", "", "external", 0.9, (), ())
    found = with_pictures(verdict_of("effect", other), (exposure, blur))
    assert (found.name, [e.name for e in found.effects]) == ("effect", ["wind", "exposure"])
    found = with_pictures(verdict_of("unknown"), (exposure, blur))
    assert (found.name, found.sentence, len(found.caveats)) == ("unknown", "The motion: unknown.", 2)
    assert with_pictures(verdict_of("none"), (blur,)) == verdict_of("none")


def test_a_figure_of_what_was_seen(camera_situation):
    found = findings(camera_situation, *filmed(drift=-0.5))
    report = SimpleNamespace(pictures=found, base=SimpleNamespace(capture=SimpleNamespace(fps=FPS)))
    figure = image_series(report)
    assert [axes.get_title() for axes in figure.axes] == ["exposure: called", "motion_blur: not called"]
    seen, told = figure.axes[0].lines[0].get_ydata(), figure.axes[0].lines[1].get_ydata()
    np.testing.assert_allclose(seen, told, atol=0.02)
