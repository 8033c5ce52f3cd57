"""The CPU kernel against the reference on the same polygons: image, gradients, directional derivatives."""

import pytest
import torch
from torch.autograd import forward_ad

from physconvex.convex import ConvexField
from physconvex.render import Splats, composite_kernel
from physconvex.render.compiled import composite_tangents
from physconvex.render.directions import load_forward_mode
from tests.convex.composites import compare_composites, compare_tangents, layers, polygons, rounding, weights
from tests.convex.fields import random_field
from tests.convex.scenes import HARD_CASES, hard_case


def compare(field: ConvexField, width: int = 37, height: int = 21) -> None:
    """Forward, backward and forward mode."""
    splats, inputs = polygons(field, width, height)
    tolerance = rounding(splats, inputs)
    compare_composites(splats, inputs, composite_kernel, tolerance)
    compare_tangents(splats, inputs, composite_tangents, tolerance)


@pytest.mark.parametrize("name", [name for name in HARD_CASES if name != "behind"])
@pytest.mark.parametrize("points", range(3, 13))
def test_hard_cases(name: str, points: int) -> None:
    compare(hard_case(name, points, seed=points))


@pytest.mark.parametrize(("width", "height"), [(16, 16), (1, 1), (50, 33)])
def test_many_convexes_on_images_of_any_size(width: int, height: int) -> None:
    compare(random_field(60, seed=5, size=0.1), width, height)


def test_nothing_to_draw() -> None:
    for field in (hard_case("behind"), random_field(2).select(torch.zeros(2, dtype=torch.bool))):
        compare(field)


def test_the_number_of_threads_does_not_change_a_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    splats, inputs = polygons(random_field(60, seed=6), 70, 40)
    results = []
    for threads in (1, 3):
        monkeypatch.setattr(torch, "get_num_threads", lambda threads=threads: threads)
        leaves = [tensor.clone().requires_grad_() for tensor in inputs]
        image = layers(splats, tuple(leaves), composite_kernel)
        (image.features.square().sum() + image.transmittance.sum()).backward()
        results.append([image.features, image.transmittance, *(leaf.grad for leaf in leaves)])
        monkeypatch.undo()
    assert all(torch.equal(*pair) for pair in zip(*results, strict=True))


def test_changed_inputs_are_noticed_before_the_backward_pass() -> None:
    splats, inputs = polygons(random_field(3))
    leaf = inputs[3].clone().requires_grad_()
    opacity = leaf * 1.0
    image = layers(splats, (*inputs[:3], opacity, inputs[4]), composite_kernel)
    with torch.no_grad():
        opacity.mul_(0.5)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        image.features.sum().backward()


def test_forward_mode_of_the_torch_function() -> None:
    load_forward_mode()
    splats, inputs = polygons(random_field(6, seed=7))
    directions = tuple(1e-2 * weights(tensor.shape).to(tensor) for tensor in inputs)
    with forward_ad.dual_level():
        duals = tuple(forward_ad.make_dual(tensor, d) for tensor, d in zip(inputs, directions, strict=True))
        image = layers(splats, duals, composite_kernel)
        tangents = [forward_ad.unpack_dual(tensor).tangent for tensor in (image.features, image.transmittance)]
    plain = Splats(splats.convex, splats.starts, *inputs[1:])
    expected = composite_tangents(plain, inputs[0], [directions])
    assert all(torch.equal(tangent, some[0]) for tangent, some in zip(tangents, expected, strict=True))
    assert tangents[0].abs().max() > 0
