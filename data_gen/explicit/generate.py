"""Falls without pictures: shapes drawn, meshed and dropped several times each, and their files."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_gen.config import GeneratorConfig
from data_gen.dataset import write_claim
from data_gen.engines import WorkerOptions, run_tasks
from data_gen.explicit.bodies import FPS, GRAVITY, LARGEST, FallingBody, falling_body
from data_gen.scene import draw_drop, draw_object
from physconvex import ConvergenceError, InputError, __version__
from physconvex.io import whole_file
from physconvex.mesh import tetrahedralize_implicit
from physconvex.numerics import one_torch_thread

SHAPES = 20  # of one file
_NODES = 1900
_NUMBERS = ("size", "youngs_modulus", "poisson_ratio", "density", "damping_time", "friction", "stiffest")


@dataclass(frozen=True)
class _Task:
    root: Path
    config: GeneratorConfig
    seed: int
    number: int
    shapes: tuple[int, int]
    nodes: int


def generate_falls(
    root: Path | str,
    *,
    shapes: int,
    config: GeneratorConfig,
    seed: int = 0,
    nodes: int = _NODES,
    work: WorkerOptions | None = None,
    on_file: Callable[[int], None] | None = None,
) -> int:
    """Make (or continue) a folder of the falls of that many shapes; returns the number of its falls.

    Each shape falls `config.objects.simulations_per_object` times. Nothing is simulated here; the bytes depend only on
    the arguments. A shape that cannot be meshed is left out.

    Args:
        root: folder.
        shapes: number of shapes.
        config: ranges of the random draws.
        seed: of everything random.
        nodes: most nodes of a mesh, at most 2,048.
        work: execution; one worker unless given.
        on_file: called with the number of shapes drawn after each file.

    Raises:
        InputError: the folder was begun with something else, or an argument out of range.
    """
    root = Path(root)
    if shapes < 1:
        raise InputError(f"shapes: got {shapes}; expected at least 1")
    if not 20 <= nodes <= LARGEST:
        raise InputError(f"nodes: got {nodes}; expected 20 to {LARGEST}, which fit into a GPU's shared memory")
    _check(config)
    claim = {"seed": seed, "configuration": config.model_dump(mode="json"), "generator_version": __version__}
    write_claim(root, claim | {"nodes": nodes})
    parts = [(first, min(first + SHAPES, shapes)) for first in range(0, shapes, SHAPES)]
    tasks = [_Task(root.resolve(), config, seed, k, part, nodes) for k, part in enumerate(parts)]
    waiting = [task for task in tasks if not _holds(_file(root, task.number), task.shapes)]
    done = shapes - sum(b - a for a, b in (task.shapes for task in waiting))
    for made in run_tasks(_make_file, waiting, work):
        done += made
        if on_file is not None:
            on_file(done)
    return len(read_falls(root))


def read_falls(root: Path | str) -> list[FallingBody]:
    """All falls of a folder.

    Raises:
        InputError: there are none.
    """
    paths = sorted(Path(root).glob("falls-[0-9]*.npz"))
    if not paths:
        raise InputError(f"falls: {root} holds no falls; make some with `physconvex generate falls --out {root}`")
    return [body for path in paths for body in load_bodies(path)]


def draw_falls(config: GeneratorConfig, seed: int, shape: int, *, nodes: int = _NODES) -> list[FallingBody]:
    """The falls of one shape; none if it cannot be meshed.

    Raises:
        InputError: the configuration requires objects of a folder, or another gravity or frame rate than that of falls.
    """
    _check(config)
    falls = config.objects.simulations_per_object
    try:
        drawn = draw_object(config, seed, shape * falls, 0)
        drops = [draw_drop(config, seed, shape * falls + number, 0, body=drawn) for number in range(falls)]
        body = drops[0].body
        assert body.signed_distance is not None
        surface = (body.vertices, body.faces)
        mesh = tetrahedralize_implicit(body.signed_distance, body.bounds, surface=surface, max_nodes=nodes, order=2)
    except (ConvergenceError, InputError):
        return []
    frames = config.video.frames
    return [falling_body(drop, mesh, scale=drop.body.size / body.size, frames=frames) for drop in drops]


def _check(config: GeneratorConfig) -> None:
    if config.objects.folder is not None:
        raise InputError(f"objects: got the folder {config.objects.folder}; expected procedural bodies")
    if config.motion.gravity != GRAVITY or config.video.fps != FPS:
        raise InputError(
            f"motion.gravity, video.fps: got {config.motion.gravity}, {config.video.fps}; expected {GRAVITY}, {FPS}, "
            "with which falls are rolled out"
        )


def _file(root: Path, number: int) -> Path:
    return root / f"falls-{number:04d}.npz"


def _holds(path: Path, shapes: tuple[int, int]) -> bool:
    """Whether a file of that many shapes exists; one of fewer, from a smaller run, is made again."""
    if not path.is_file():
        return False
    with np.load(path, allow_pickle=False) as file:
        return json.loads(str(file["drawn"])) == list(shapes)


def _make_file(task: _Task) -> int:
    with one_torch_thread():
        found = [draw_falls(task.config, task.seed, shape, nodes=task.nodes) for shape in range(*task.shapes)]
    save_bodies(_file(task.root, task.number), [falls for falls in found if falls], drawn=task.shapes)
    return task.shapes[1] - task.shapes[0]


def save_bodies(path: Path, shapes: Sequence[Sequence[FallingBody]], *, drawn: tuple[int, int]) -> None:
    """Write the falls of some shapes, each of which shares corners and tetrahedra, atomically.

    Args:
        path: of the file.
        shapes: the falls of each.
        drawn: numbers of the first shape drawn for it and of the one beyond the last; some draws may fail.

    Raises:
        ConvergenceError: no shape is there.
    """
    if not shapes:
        raise ConvergenceError(f"none of the shapes {drawn[0]} to {drawn[1] - 1} could be meshed")
    bodies = [body for shape in shapes for body in shape]
    first = [shape[0] for shape in shapes]
    content = {name: np.array([getattr(body, name) for body in bodies]) for name in _NUMBERS}
    content |= {name: np.stack([getattr(body, name) for body in bodies]) for name in ("place", "velocity", "spin")}
    for name in ("turns", "centres"):
        content[name] = np.concatenate([getattr(body, name) for body in bodies])
    content["drawn"] = np.array(json.dumps(drawn))
    content["flights"] = np.array([len(body.turns) for body in bodies])
    content["falls"] = np.array([len(shape) for shape in shapes])
    for name in ("corners", "tets"):
        content[name] = np.concatenate([getattr(shape, name) for shape in first])
        content[f"{name}_count"] = np.array([len(getattr(shape, name)) for shape in first])
    with whole_file(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **content)


def load_bodies(path: Path) -> list[FallingBody]:
    """Read a file of `save_bodies`."""
    with np.load(path, allow_pickle=False) as file:
        content = {name: file[name] for name in file.files}
    corners, tets = (np.split(content[name], np.cumsum(content[f"{name}_count"])[:-1]) for name in ("corners", "tets"))
    turns, centres = (np.split(content[name], np.cumsum(content["flights"])[:-1]) for name in ("turns", "centres"))
    shape = np.repeat(np.arange(len(content["falls"])), content["falls"])
    return [
        FallingBody(
            corners=corners[shape[k]],
            tets=tets[shape[k]],
            place=content["place"][k],
            velocity=content["velocity"][k],
            spin=content["spin"][k],
            turns=turns[k],
            centres=centres[k],
            **{name: float(content[name][k]) for name in _NUMBERS},
        )
        for k in range(len(shape))
    ]
