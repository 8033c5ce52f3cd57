"""The error of a held body's mesh, after E has made up for what it can."""

from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.gap import GapOptions, PointMotion
from physconvex.gap.base.baseline import Split
from physconvex.gap.base.cost import Cost
from physconvex.gap.base.model import EffectModel
from physconvex.gap.errors.numerical_differences import Numerics, with_absorbed_mesh
from physconvex.identify import default_parameter

TIMES = np.arange(40) / 100
REST = np.array([[0.1, 0.0, 0.0], [0.05, 0.0, 0.0]])
FINE, SHARE = 1.1, 0.02  # the coarse mesh is stiffer by so much, and bends in a slightly other shape


class Bending:
    """A point mass in place of the body: it swings with √E, a mesh has a factor on E and a shape."""

    base = names = ("log10_youngs_modulus",)
    points = REST

    def __init__(self, frames=40, stiffer=FINE, other=SHARE):
        self.frames, self.stiffer, self.other, self.cost = frames, stiffer, other, Cost()

    def parameters(self, values):
        return (default_parameter("log10_youngs_modulus").at(float(values[0])),)

    def motion(self, values):
        t = TIMES[: self.frames]
        sag = 0.01 * (1 - np.cos(50 * np.sqrt(self.stiffer * 10 ** (values[0] - 5)) * t))
        moved = np.repeat(REST[None], len(t), axis=0)
        moved[:, 0, 2] -= sag
        moved[:, 1, 2] -= (0.3 + self.other) * sag
        return PointMotion(REST, t, moved, np.zeros_like(moved))

    def positions(self, values):
        return self.motion(values).positions

    def linearise(self, values, motion):
        return motion.positions, ((self.positions(values + 0.01) - motion.positions) / 0.01)[:, None]

    secant = EffectModel.secant


@pytest.fixture
def base(monkeypatch):
    monkeypatch.setattr(
        "physconvex.gap.errors.numerical_differences.replace",
        lambda thing, **changes: (
            Bending(changes.get("frames", 40)) if isinstance(thing, Bending) else thing.changed(**changes)
        ),
    )
    fine, values = Bending(stiffer=1.0, other=0.0), np.array([5.0])
    return SimpleNamespace(
        situation=SimpleNamespace(clamped=True, size=0.1), model=fine, motion=fine.motion(values),
        fit=SimpleNamespace(values=values), split=Split(np.arange(25), np.arange(0), np.arange(0)),
    )  # fmt: skip


class Differences(SimpleNamespace):
    def changed(self, **changes):
        return Differences(**(self.__dict__ | changes))


@pytest.mark.wrong_types
def test_what_a_change_of_the_modulus_makes_up_for_is_no_error(base):
    mesh = Bending().positions(base.fit.values) - base.motion.positions
    found = with_absorbed_mesh(base, Differences(fine=("mesh", None), mesh=mesh, absorbed_mesh=None), GapOptions())
    left = np.abs(found.absorbed_mesh).max(axis=(0, 2))
    assert np.abs(mesh).max() > 5e-3  # out of step after some periods
    assert left[0] < 2e-4 and left[1] == pytest.approx(SHARE * 0.02, rel=0.5)  # the shape is no matter of E


@pytest.mark.wrong_types
def test_free_bodies_and_unaffordable_meshes_are_left(base):
    differences = Differences(fine=None, mesh=np.zeros((40, 2, 3)))
    assert with_absorbed_mesh(base, differences, GapOptions()) is differences
    base.situation.clamped = False
    differences = Differences(fine=("mesh", None), mesh=np.zeros((40, 2, 3)))
    assert with_absorbed_mesh(base, differences, GapOptions()) is differences


def test_the_absorbed_difference_is_the_null(base):
    zero = np.zeros((40, 2, 3))
    numerics = Numerics(zero, zero + 1.0, zero, zero, zero, nodes=(150, 800), absorbed_mesh=zero + 0.5)
    ratio = 1 / ((800 / 150) ** (1.75 / 3) - 1)
    assert numerics.null[1] == pytest.approx(0.5 * ratio)
