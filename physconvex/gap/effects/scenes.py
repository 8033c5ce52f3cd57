"""Changes that apply to both reduced and full-order scenes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError
from physconvex.fem import ElasticBody
from physconvex.gap.effects.effect import AnyScene
from physconvex.materials import LAWS, FlowRule, Flows, Law, Plasticine, less_ground
from physconvex.reduced import Cubature, ReducedBody, ReducedScene

Points = Float[np.ndarray, "N 3"]


def scaled_coordinates(scene: AnyScene, points: Points) -> Points:
    """Rest positions [m], scaled so that the bounding box of the body is [-1, 1]³."""
    body = scene.body
    box = body.space.samples.surface_points if isinstance(body, ReducedBody) else body.mesh.vertices
    low, high = box.min(0), box.max(0)
    return np.asarray(2 * (points - low) / (high - low) - 1)


def _cell_means(samples: Cubature, values: Float[np.ndarray, " N"]) -> Float[np.ndarray, " C"]:
    """Mean per cell of values at a reduced body's samples."""
    return np.bincount(samples.cells, samples.weights * values) / np.bincount(samples.cells, samples.weights)


def _cell_coordinates(scene: AnyScene) -> Float[np.ndarray, "C 3"]:
    """Scaled coordinates of the cells' centres."""
    if isinstance(scene, ReducedScene):
        interior = scene.body.space.samples.interior
        centres = np.stack([_cell_means(interior, x) for x in interior.points.T], axis=1)
    else:
        mesh = scene.body.mesh
        centres = mesh.vertices[mesh.corner_tets].mean(1)
    return scaled_coordinates(scene, centres)


def _modulus_times(scene: AnyScene, field: Callable[[Points], Float[np.ndarray, " N"]]) -> Float[np.ndarray, "C ..."]:
    """E times a field of the scaled coordinates: at the quadrature points; for a reduced body, the mean of each cell.

    Values at the centres alone miss a softer rim in a bar that is one element thick.
    """
    if isinstance(scene, ReducedScene):
        interior = scene.body.space.samples.interior
        factor = _cell_means(interior, field(scaled_coordinates(scene, interior.points)))
        return np.asarray(scene.body.youngs_modulus * factor)
    modulus, points = scene.body.modulus_at_points, scene.body.quadrature_points.reshape(-1, 3)
    return np.asarray(modulus * field(scaled_coordinates(scene, points)).reshape(modulus.shape))


def cell_masses(scene: AnyScene) -> Float[np.ndarray, " C"]:
    """Mass of each cell [kg]."""
    if isinstance(scene, ReducedScene):
        samples = scene.body.space.samples.mass
        return np.bincount(samples.cells, samples.weights * scene.body.density[samples.cells], samples.cell_count)
    return np.asarray(scene.body.mesh.element_volumes * scene.body.density)


def _together(present: FlowRule | None, added: FlowRule | None) -> FlowRule | None:
    """Combination of two flow rules.

    Raises:
        InputError: the body already flows this way.
    """
    if present is None or added is None:
        return present or added
    if isinstance(present, Flows) or type(present) is type(added):
        raise InputError(f"flow: the body flows already ({present}); expected another way of flowing, and two at most")
    return Flows(present, added)


def _apart(law: Law, flow: FlowRule | None) -> tuple[Law, FlowRule | None]:
    """Move additions to the law of a plastic body into a parallel part that does not flow.

    Raises:
        InputError: the law is neither that of the body nor an extension of it.
    """
    if isinstance(flow, Flows):
        law, first = _apart(law, flow.first)
        law, second = _apart(law, flow.second)
        assert first is not None and second is not None
        return law, Flows(first, second)
    if not isinstance(flow, Plasticine) or flow.beside_law or flow.elastic == law.name:
        return law, flow
    if flow.elastic == "hencky" and law.name in LAWS:
        return law, flow
    if law.ground is None or law.ground.name != flow.elastic:
        raise InputError(f"law: got {law.name} of a plastic body; expected {flow.elastic}, or something added to it")
    return less_ground(law, law.ground), replace(flow, beside_law=True)


def with_material(
    scene: AnyScene,
    *,
    law: Callable[[Law], Law] | None = None,
    flow: FlowRule | None = None,
    modulus: Callable[[Points], Float[np.ndarray, " N"]] | None = None,
    density: Callable[[Float[np.ndarray, "C 3"], Float[np.ndarray, " C"]], Float[np.ndarray, " C"]] | None = None,
) -> AnyScene:
    """The scene with another material; contact (and pins) keep their stiffness.

    Args:
        scene: reduced or full-order.
        law: makes the new elastic law from the present one.
        flow: flow rule of the material.
        modulus: factor on E as a field of the scaled coordinates.
        density: factor on the density from the cells' scaled coordinates and masses [kg].
    """
    body, stiffness = scene.body, scene.contact().stiffness
    new_law, new_flow = _apart(body.law if law is None else law(body.law), _together(body.flow, flow))
    heavier = 1.0 if density is None else density(_cell_coordinates(scene), cell_masses(scene))
    constants: dict[str, Any] = {
        "law": new_law,
        "youngs_modulus": body.youngs_modulus if modulus is None else _modulus_times(scene, modulus),
        "poisson_ratio": body.poisson_ratio,
        "density": body.density * heavier,
        "flow": new_flow,
    }
    if isinstance(scene, ReducedScene):
        assert isinstance(body, ReducedBody)
        pins = scene.pins
        if pins is not None and pins.stiffness is None:
            springs = scene.pin_springs()
            assert springs is not None
            pins = replace(pins, stiffness=float(springs.weights[0] / np.asarray(pins.areas)[0]))
        return replace(scene, body=ReducedBody(body.space, **constants), contact_stiffness=stiffness, pins=pins)
    assert isinstance(body, ElasticBody)
    return replace(scene, body=ElasticBody(body.mesh, **constants), contact_stiffness=stiffness)
