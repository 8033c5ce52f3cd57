"""Clip and mirror image get one answer."""

import torch

from models import PhysicsNetwork, answer_both_ways
from models.mirror import mirrored_batch
from tests.models.test_network import NETWORK, random_batch


def test_a_mirror_image_twice_is_the_clip() -> None:
    batch = random_batch(2)
    again = mirrored_batch(mirrored_batch(batch))
    for name, value in vars(batch).items():
        assert torch.equal(getattr(again, name), value), name
    assert not torch.equal(mirrored_batch(batch).moments, batch.moments)


def test_clip_and_mirror_image_get_one_answer() -> None:
    torch.manual_seed(0)
    network = PhysicsNetwork(NETWORK).eval()
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.2)
    batch = random_batch(2)
    here, there = answer_both_ways(network, batch), answer_both_ways(network, mirrored_batch(batch))
    for name in ("stiffness_logits", "poisson_logits"):
        density = getattr(here, name).softmax(dim=-1)
        torch.testing.assert_close(density, getattr(there, name).softmax(dim=-1))
        parts = [getattr(network(x), name).softmax(dim=-1) for x in (batch, mirrored_batch(batch))]
        torch.testing.assert_close(density, (parts[0] + parts[1]) / 2)
        assert (parts[0] - parts[1]).abs().max() > 1e-4
