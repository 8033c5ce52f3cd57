"""A surface moved to where the pictures agree, and its colours.

Around each vertex a patch in its tangent plane is moved along the normal. Where the patches of two pictures correlate
best, the surface is; a smooth displacement follows these places, each as strongly as the pictures tell.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sparse
import torch
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.sparse.linalg import splu
from torch import Tensor
from torch.nn.functional import grid_sample

from physconvex.io import Camera
from physconvex.reconstruction.carving import footprint, hull_distance
from physconvex.reconstruction.observation import Observation
from physconvex.reconstruction.outline_fit import outline_displacements

ROUNDS, FIRST_REACH, NARROWER = 4, 3.0, 0.7  # of the search; its first reach [cells], and the factor per round
STEPS = 6  # offsets on either side
PATCH = 3  # pixels on either side of a vertex
VIEWS = 4  # that see a vertex best
AGREE = 2  # pictures that show a place: fewer say nothing of its depth
STEEPEST = 0.25  # least cosine between a normal and a ray
HIDDEN = 2.5  # cells behind the nearest surface
DARK = 0.01  # standard deviation of colour that is noise
EVENED = 5  # rounds of averages of the colours' spread over neighbours
SHARED = 2  # rounds of averages of the correlation over neighbours
TELLING = 0.2  # excess of the best correlation over the median that tells all
# weights of the displacement: of a full agreement (1), of an outline, of the old place where the pictures say nothing
# and where one or none shows it; of the bending of the whole, and of the membrane where one or none shows it
ON_OUTLINE, UNSURE, UNSEEN, BENDING, MEMBRANE = 0.5, 0.002, 1e-5, 0.05, 0.003

PlacedNormals = tuple[Float[np.ndarray, "Q 3"], Float[np.ndarray, "Q 3"]]
"""Places on a surface [m] and its normals there."""


def moved_to_agreement(
    surface: trimesh.Trimesh, observations: Sequence[Observation], *, cell: float
) -> trimesh.Trimesh:
    """The surface with displaced vertices.

    Args:
        surface: closed, outward oriented [m], with edges of about one cell.
        cell: its accuracy [m].
    """
    edges = surface.edges_unique
    means = _neighbour_means(edges, len(surface.vertices))
    for turn in range(ROUNDS):
        normals, vertices = np.asarray(surface.vertex_normals), np.asarray(surface.vertices)
        offsets = FIRST_REACH * cell * NARROWER**turn * np.arange(-STEPS, STEPS + 1) / STEPS
        towards = facing(surface, observations, cell=cell)
        cosines = _shown(towards)
        views = (cosines > 0).sum(axis=1)
        offset, certain = _best_offsets(_correlations(surface, observations, cosines, offsets), offsets, means)
        beyond = hull_distance(observations, vertices)
        missing, outlines = outline_displacements(surface, observations, towards, cell=cell)
        held, drawn = np.where(views < AGREE, UNSEEN, UNSURE), ON_OUTLINE * outlines
        along = -held * np.maximum(beyond, 0) + certain * offset + drawn * missing
        wanted = (held + certain + drawn)[:, None] * vertices + along[:, None] * normals
        stiffness = sparse.diags(held + certain + drawn) + _smoothness(edges, means, views < AGREE)
        surface = trimesh.Trimesh(splu(stiffness.tocsc()).solve(wanted), surface.faces, process=False)
    return surface


def colours_seen(
    surface: trimesh.Trimesh, observations: Sequence[Observation], *, cell: float
) -> Float[np.ndarray, "V 3"]:
    """Colour of each vertex, 0 to 1: the mean over the views by the squared cosine; unseen ones by their neighbours."""
    total, weight = colour_sums(surface, observations, (surface.vertices, surface.vertex_normals), cell=cell)
    across = edge_differences(surface.edges_unique, len(total))
    spread = sparse.diags(weight + 1e-9) + 1e-3 * across.T @ across
    return np.clip(splu(spread.tocsc()).solve(total), 0, 1)


def colour_sums(
    surface: trimesh.Trimesh, observations: Sequence[Observation], at: PlacedNormals, *, cell: float
) -> tuple[Float[np.ndarray, "Q 3"], Float[np.ndarray, " Q"]]:
    """Sums over the views of the colours at places on the surface by the squared cosine, and of the weights."""
    cosines = _shown(facing(surface, observations, cell=cell, at=at))
    total = np.zeros((len(cosines), 3))
    for cosine, seen in zip(cosines.T, observations, strict=True):
        total += cosine[:, None] ** 2 * _sampled(seen, np.asarray(at[0])).numpy()
    return total, np.square(cosines).sum(axis=1)


def cosines_shown(
    surface: trimesh.Trimesh, observations: Sequence[Observation], *, cell: float
) -> Float[np.ndarray, "V C"]:
    """Cosine between normal and ray to each camera; zero if hidden or grazing, by the accuracy `cell` [m]."""
    return _shown(facing(surface, observations, cell=cell))


def colour_spread(
    surface: trimesh.Trimesh, observations: Sequence[Observation], cosines: Float[np.ndarray, "V C"]
) -> Float[np.ndarray, " V"]:
    """Standard deviation of the colours in which the views show each vertex, evened over its neighbours.

    Args:
        surface: closed, outward oriented [m].
        observations: the views.
        cosines: of `cosines_shown`.
    """
    apart = colours_apart(np.asarray(surface.vertices), observations, cosines)
    spread = np.sqrt(np.einsum("vc,vc->v", _shares(cosines), apart**2))
    return _evened(spread, _neighbour_means(surface.edges_unique, len(spread)), EVENED)


def colours_apart(
    places: Float[np.ndarray, "V 3"], observations: Sequence[Observation], cosines: Float[np.ndarray, "V C"]
) -> Float[np.ndarray, "V C"]:
    """Distance of the colour in which each view shows a place from the mean over the views by the squared cosine."""
    colours = np.stack([_sampled(seen, places).numpy() for seen in observations], axis=1)  # [V, C, 3]
    return np.linalg.norm(colours - np.einsum("vc,vci->vi", _shares(cosines), colours)[:, None], axis=2)


def patterns_apart(
    at: PlacedNormals, observations: Sequence[Observation], cosines: Float[np.ndarray, "Q C"]
) -> tuple[Float[np.ndarray, "Q C"], Float[np.ndarray, "Q C"]]:
    """How the views' patches around places differ, whatever the light: rms distance from their mean, and rms size.

    Of each patch its own mean is taken away; the mean over the views is by the squared cosine.
    """
    places, normals = at
    patches, shares = _patches(normals, footprint(observations)), _shares(cosines)
    mean, shown = np.zeros((*patches.shape[:2], 3), np.float32), []
    for cosine, share, seen in zip(cosines.T, shares.T, observations, strict=True):
        rows = np.nonzero(cosine > 0)[0]
        colours = _sampled(seen, places[rows, None] + patches[rows]).numpy()
        colours -= colours.mean(axis=1, keepdims=True)
        mean[rows] += share[rows, None, None].astype(np.float32) * colours
        shown.append((rows, colours))
    apart, size = np.zeros(cosines.shape), np.zeros(cosines.shape)
    for column, (rows, colours) in enumerate(shown):
        for out, part in ((apart, colours - mean[rows]), (size, colours)):
            out[rows, column] = np.sqrt(np.square(part).sum(axis=2).mean(axis=1))
    return apart, size


def _shares(cosines: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V C"]:
    """Weights of the views by the squared cosine; their sum is 1, or 0 where none shows the place."""
    return np.square(cosines) / np.maximum(np.square(cosines).sum(axis=1, keepdims=True), 1e-12)


def nearest_pixels(camera: Camera, positions: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Row and column of the pixel that is nearest to each position, and depths [m]."""
    pixels, depths = camera.project(positions)
    columns, rows = np.clip(np.floor(np.nan_to_num(pixels)), 0, [camera.w - 1, camera.h - 1]).astype(int).T
    return (rows, columns), depths


def facing(
    surface: trimesh.Trimesh, observations: Sequence[Observation], *, cell: float, at: PlacedNormals | None = None
) -> Float[np.ndarray, "Q C"]:
    """Cosine between normal and ray to each camera, at the vertices or at other places; NaN if hidden."""
    positions, normals = map(np.asarray, (surface.vertices, surface.vertex_normals) if at is None else at)
    pixel = footprint(observations)
    points, _ = trimesh.sample.sample_surface(surface, int(8 * surface.area / pixel**2), seed=0)
    cosines = np.zeros((len(positions), len(observations)))
    for column, seen in enumerate(observations):
        camera = seen.camera
        nearest = np.full((camera.h, camera.w), np.inf)
        place, depth = nearest_pixels(camera, points)
        np.minimum.at(nearest, place, depth)
        towards = camera.position - positions
        cosine = np.einsum("vi,vi->v", normals, towards) / np.linalg.norm(towards, axis=1)
        place, depth = nearest_pixels(camera, positions)
        cosines[:, column] = np.where(depth < nearest[place] + HIDDEN * cell, cosine, np.nan)
    return cosines


def _shown(towards: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V C"]:
    """Cosines, zero where hidden or grazing."""
    return np.where(towards > STEEPEST, towards, 0.0)


def _sampled(seen: Observation, positions: Float[np.ndarray, "... 3"]) -> Float[Tensor, "... 3"]:
    """Colours of the picture at positions [m], bilinear."""
    pixels, _ = seen.camera.project(positions)
    grid = torch.as_tensor(2 * pixels / [seen.camera.w, seen.camera.h] - 1, dtype=torch.float32)
    image = seen.image.permute(2, 0, 1)[None]
    colours = grid_sample(image, grid.reshape(1, 1, -1, 2), padding_mode="border", align_corners=False)
    return colours[0, :, 0].T.reshape(positions.shape)


def _correlations(
    surface: trimesh.Trimesh,
    observations: Sequence[Observation],
    cosines: Float[np.ndarray, "V C"],
    offsets: Float[np.ndarray, " S"],
) -> Float[np.ndarray, "V S"]:
    """Mean correlation of the colours of a vertex's patch between its views, per offset; NaN with fewer than two."""
    vertices, normals = np.asarray(surface.vertices), np.asarray(surface.vertex_normals)
    patches = _patches(normals, footprint(observations))
    order = np.argsort(-cosines, axis=1)[:, :VIEWS]
    used = torch.as_tensor(np.take_along_axis(cosines, order, axis=1) > 0)
    both = torch.triu(used[:, :, None] & used[:, None, :], diagonal=1).float()
    scores = np.full((len(vertices), len(offsets)), np.nan)
    for column, offset in enumerate(offsets):
        places = (vertices + offset * normals)[:, None] + patches
        colours = torch.zeros(*order.shape, patches.shape[1], 3)
        for number, seen in enumerate(observations):
            rows, slots = np.nonzero((order == number) & used.numpy())
            colours[rows, slots] = _sampled(seen, places[rows])
        colours -= colours.mean(dim=2, keepdim=True)
        spread = colours.square().mean(dim=(2, 3), keepdim=True).sqrt()
        flat = (colours / (spread + DARK)).flatten(start_dim=2)
        pairs = torch.einsum("vap,vbp->vab", flat, flat) / flat.shape[2]
        scores[:, column] = ((both * pairs).sum(dim=(1, 2)) / both.sum(dim=(1, 2))).numpy()
    return scores


def _patches(normals: Float[np.ndarray, "V 3"], pixel: float) -> Float[np.ndarray, "V P 3"]:
    """Squares of points in the tangent planes, a pixel [m] apart, about the origin."""
    across = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)  # a vertex of flat triangles has none
    along = np.cross(normals, across)
    steps = pixel * np.arange(-PATCH, PATCH + 1)
    first, second = (grid.ravel()[None, :, None] for grid in np.meshgrid(steps, steps))
    return first * across[:, None] + second * along[:, None]


def _best_offsets(
    scores: Float[np.ndarray, "V S"], offsets: Float[np.ndarray, " S"], means: sparse.spmatrix
) -> tuple[Float[np.ndarray, " V"], Float[np.ndarray, " V"]]:
    """Offset [m] of the best correlation, and how certain it is, 0 to 1.

    The best place at the outer end says nothing; that at the inner end says that the surface lies farther inside.
    """
    known = np.isfinite(scores).all(axis=1)
    shared = _evened(np.where(known[:, None], scores, 0.0), means, SHARED)
    weight = _evened(known.astype(float), means, SHARED)
    shared /= np.maximum(weight, 1e-6)[:, None]
    rows, best = np.arange(len(scores)), shared.argmax(axis=1)
    middle = np.clip(best, 1, len(offsets) - 2)
    before, peak, after = (shared[rows, middle + step] for step in (-1, 0, 1))
    curvature = np.maximum(2 * peak - before - after, 1e-6)
    place = middle + np.clip(0.5 * (after - before) / curvature, -1, 1)
    telling = np.clip((peak - np.median(shared, axis=1)) / TELLING, 0, 1)
    certain = np.where(known & (best < len(offsets) - 1), np.clip(peak, 0, 1) ** 2 * telling, 0.0)
    return np.interp(place, np.arange(len(offsets)), offsets), certain


def _smoothness(
    edges: Int[np.ndarray, "E 2"], means: sparse.spmatrix, unseen: Bool[np.ndarray, " V"]
) -> sparse.spmatrix:
    """Bending of the seen part, and a membrane over the edges of the rest, [V, V]."""
    bent = sparse.diags(np.where(unseen, 0.1, 1.0)) @ (sparse.eye(len(unseen)) - means)
    across = edge_differences(edges[unseen[edges].any(axis=1)], len(unseen))
    return BENDING * bent.T @ bent + MEMBRANE * across.T @ across


def edge_differences(edges: Int[np.ndarray, "E 2"], count: int) -> sparse.spmatrix:
    """Difference of the vertices of each edge, [E, count]."""
    rows = np.arange(len(edges)).repeat(2)
    return sparse.csr_matrix((np.tile([1.0, -1.0], len(edges)), (rows, edges.ravel())), (len(edges), count))


def _evened(values: np.ndarray, means: sparse.spmatrix, rounds: int) -> np.ndarray:
    """Values of vertices, averaged with the means of their neighbours."""
    for _ in range(rounds):
        values = 0.5 * (values + means @ values)
    return values


def _neighbour_means(edges: Int[np.ndarray, "E 2"], count: int) -> sparse.spmatrix:
    """Mean over the neighbours, [count, count]."""
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    links = sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), (count, count))
    return sparse.diags(1 / np.maximum(np.asarray(links.sum(axis=1))[:, 0], 1)) @ links
