"""The capture folder: metadata in `capture.json`; all other files are read on request."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from physconvex.errors import InputError
from physconvex.io.camera import Camera
from physconvex.io.capture.metadata import CAPTURE_FILE, CaptureFile, read_capture_file
from physconvex.io.capture.parts import Boundary, Tracks, read_arrays, read_boundary, read_tracks
from physconvex.io.video.images import IMAGE_SUFFIXES, read_image, read_image_sequence
from physconvex.io.video.reading import read_video
from physconvex.io.video.result import Video

if TYPE_CHECKING:
    import trimesh

    from physconvex.mesh import TetMesh

_DEFAULTS = CaptureFile.model_fields
MESH_SUFFIXES = (".obj", ".ply", ".glb")


@dataclass(frozen=True, eq=False)
class Floor:
    """A half-space that the body cannot enter."""

    point: Float64[np.ndarray, " 3"]  # [m]
    normal: Float64[np.ndarray, " 3"]  # unit vector, away from the floor
    friction: float | None = None  # Coulomb's coefficient; None: unknown

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.normal))
        if not length > 0:
            raise InputError(f"floor.normal: got {list(self.normal)}, expected a vector that is not zero")
        if self.friction is not None and not self.friction >= 0:
            raise InputError(f"floor.friction: got {self.friction}, expected a number of at least 0")
        object.__setattr__(self, "normal", np.asarray(self.normal, dtype=np.float64) / length)


@dataclass(frozen=True, eq=False)
class Capture:
    """A recording of one motion of one object, in SI units, world frame with z up.

    Frame 0 is the state at t = 0. The first `observed_frames` may be fitted; the others are to be predicted. Initial
    velocities are None if the capture does not state them. A camera has a video, a folder of images, or one picture of
    frame 0. `body` takes the place of the capture's own rest geometry.
    """

    folder: Path
    fps: float  # [1/s]
    frames: int
    observed_frames: int
    cameras: tuple[Camera, ...] = ()
    gravity: Float64[np.ndarray, " 3"] = field(default_factory=lambda: np.array(_DEFAULTS["gravity"].default))  # [m/s²]
    density: float = _DEFAULTS["density"].default  # [kg/m³]
    floor: Floor | None = None
    initial_velocity: Float64[np.ndarray, " 3"] | None = None  # [m/s] of the centre of mass
    initial_angular_velocity: Float64[np.ndarray, " 3"] | None = None  # [rad/s]
    body: trimesh.Trimesh | None = None  # closed surface at rest [m]

    def __post_init__(self) -> None:
        if not 1 <= self.observed_frames <= self.frames:
            raise InputError(f"observed_frames: got {self.observed_frames}, expected 1 to frames = {self.frames}")
        names = [camera.name for camera in self.cameras]
        if len(set(names)) != len(names):
            raise InputError(f"cameras: got the names {names}, expected each once")
        for name in names:
            if not name or name in (".", "..") or Path(name).name != name or name.endswith("_mask"):
                raise InputError(f"cameras: name {name!r} cannot name a file; use letters, digits, - and _")

    @property
    def times(self) -> Float64[np.ndarray, " T"]:
        """Time of each frame [s]."""
        return np.arange(self.frames) / self.fps

    @property
    def object_size(self) -> float | None:
        """Largest edge of the rest bounding box [m]; None without mesh and tetrahedra."""
        mesh = self.mesh()
        if mesh is not None:
            return float(np.ptp(np.asarray(mesh.vertices), axis=0).max())
        tets = self.tets()
        return None if tets is None else float(np.ptp(tets.vertices, axis=0).max())

    def camera(self, name: str) -> Camera:
        """The camera of that name."""
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise InputError(f"camera: got {name!r}, expected one of {[camera.name for camera in self.cameras]}")

    @property
    def filmed(self) -> tuple[Camera, ...]:
        """The cameras with moving images; the others may have masks alone, or one picture of frame 0."""
        return tuple(camera for camera in self.cameras if self._moves(camera.name))

    @property
    def recorded(self) -> tuple[Camera, ...]:
        """The cameras that recorded the motion: all but those with one picture of frame 0 alone."""
        return tuple(camera for camera in self.cameras if self._moves(camera.name) or not self._still(camera.name))

    @property
    def pictured(self) -> tuple[Camera, ...]:
        """The cameras with a picture of frame 0: from a video, or alone."""
        return tuple(camera for camera in self.cameras if self._moves(camera.name) or self._still(camera.name))

    def _moves(self, camera: str) -> bool:
        """Whether a camera has a video, or a folder of images."""
        return any(map(_is_there, self._pictures(camera)))

    def _still(self, camera: str) -> Path | None:
        """The one picture of frame 0 of a camera."""
        paths = (self.folder / f"{camera}{suffix}" for suffix in IMAGE_SUFFIXES)
        return next((path for path in paths if _is_there(path)), None)

    def _pictures(self, camera: str) -> tuple[Path, Path]:
        """Possible paths of its images: a video, a folder."""
        return self.folder / f"{camera}.mp4", self.folder / camera

    def video(self, camera: str) -> Video:
        """All frames of one camera, timed by the capture's rate (not the file's).

        Raises:
            InputError: no video of that camera; another size than the camera's; fewer frames than stated.
        """
        size = self.camera(camera)
        movie, images = self._pictures(camera)
        if images.is_dir():
            video, path = read_image_sequence(images, fps=self.fps), images
        elif _is_there(movie):
            video, path = read_video(movie, max_frames=max(2, self.frames)), movie
        else:
            raise InputError(
                f"{movie}: no such file, nor a folder {images.name}/ of images; record or remove the camera"
            )
        _check_frames(path, video.frames.shape, (self.frames, size.h, size.w))
        alpha = None if video.alpha is None else video.alpha[: self.frames]
        return replace(video, frames=video.frames[: self.frames], alpha=alpha, fps=self.fps, timestamps=self.times)

    def first_frame(self, camera: str) -> tuple[UInt8[np.ndarray, "H W 3"], UInt8[np.ndarray, "H W"] | None]:
        """Frame 0 of one camera, and its alpha: from `<camera>.png` (or .jpg), else from its video.

        Raises:
            InputError: see `video`; a picture of another size than the camera's.
        """
        size = self.camera(camera)
        path = self._still(camera)
        if path is None:
            video = self.video(camera)
            return video.frames[0], None if video.alpha is None else video.alpha[0]
        rgba = read_image(path)
        _check_frames(path, (self.frames, *rgba.shape[:2]), (self.frames, size.h, size.w))
        return rgba[..., :3], None if rgba[..., 3].min() == 255 else rgba[..., 3]

    def first_mask(self, camera: str) -> Bool[np.ndarray, "H W"] | None:
        """The object's mask in frame 0, from `<camera>_mask.png`, else `<camera>_mask.mp4`; None without either."""
        path = self.folder / f"{camera}_mask.png"
        if _is_there(path):
            size, picture = self.camera(camera), read_image(path)
            _check_frames(path, (self.frames, *picture.shape[:2]), (self.frames, size.h, size.w))
            return picture[..., 0] > 127
        if not (self.folder / f"{camera}_mask.mp4").exists():
            return None
        mask = self.mask(camera)
        return None if mask is None else mask[0]

    def mask(self, camera: str) -> Bool[np.ndarray, "T H W"] | None:
        """The object's mask, from `<camera>_mask.mp4` or the images' alpha; None without any."""
        size, path = self.camera(camera), self.folder / f"{camera}_mask.mp4"
        if path.exists():
            frames = read_video(path, max_frames=max(2, self.frames)).frames[..., 0]
            _check_frames(path, frames.shape, (self.frames, size.h, size.w))
            coverage: np.ndarray | None = frames[: self.frames]
        else:
            coverage = self.video(camera).alpha
        return None if coverage is None else coverage > 127

    def tracks(self) -> Tracks | None:
        """Marker tracks, or None."""
        path = self.folder / "tracks.npz"
        if not path.exists():
            return None
        tracks = read_tracks(path)
        if len(tracks.positions) != self.frames:
            raise InputError(f"{path}: positions has {len(tracks.positions)} frames, {CAPTURE_FILE} has {self.frames}")
        return tracks

    def mesh(self) -> trimesh.Trimesh | None:
        """Rest geometry in the world frame at t = 0, vertices as in the file; None without any."""
        if self.body is not None:
            return self.body
        paths = [self.folder / f"mesh{suffix}" for suffix in MESH_SUFFIXES]
        found = [path for path in paths if path.exists()]
        if len(found) > 1:
            raise InputError(f"{self.folder}: holds {[path.name for path in found]}, expected one mesh")
        return read_mesh(found[0]) if found else None

    def tets(self) -> TetMesh | None:
        """Tetrahedra of the rest geometry, or None."""
        path = self.folder / "tets.npz"
        if self.body is not None or not path.exists():
            return None
        from physconvex.mesh import TetMesh  # loads torch, which a reader of videos does not need

        arrays = read_arrays(path, needed=("vertices", "tets"))
        try:
            return TetMesh(arrays["vertices"], arrays["tets"])
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    def boundary(self) -> Boundary | None:
        """The held part, or None."""
        path = self.folder / "boundary.npz"
        if not path.exists():
            return None
        boundary = read_boundary(path)
        if boundary.motion is not None and len(boundary.motion) != self.frames:
            raise InputError(f"{path}: motion has {len(boundary.motion)} frames, {CAPTURE_FILE} has {self.frames}")
        return boundary


def load_capture(path: Path | str) -> Capture:
    """Read `capture.json` of a folder; videos, meshes and arrays are read on request.

    Raises:
        InputError: no such folder or file, or a missing or wrong field.
    """
    folder = Path(path)
    if folder.name == CAPTURE_FILE:
        folder = folder.parent
    path = folder / CAPTURE_FILE
    stated = read_capture_file(path)
    floor = stated.floor
    try:
        return Capture(
            folder=folder,
            fps=stated.fps,
            frames=stated.frames,
            observed_frames=stated.frames if stated.observed_frames is None else stated.observed_frames,
            cameras=tuple(map(Camera.of_entry, stated.cameras)),
            gravity=np.array(stated.gravity),
            density=stated.density,
            floor=None if floor is None else Floor(np.array(floor.point), np.array(floor.normal), floor.friction),
            initial_velocity=_vector(stated.initial_velocity),
            initial_angular_velocity=_vector(stated.initial_angular_velocity),
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _vector(values: tuple[float, float, float] | None) -> Float64[np.ndarray, " 3"] | None:
    return None if values is None else np.array(values)


def _is_there(path: Path) -> bool:
    """Whether there is a file, a folder, or a link (a broken one too, so that errors can name it)."""
    return path.exists() or path.is_symlink()


def _check_frames(path: Path, got: tuple[int, ...], expected: tuple[int, int, int]) -> None:
    if got[1:3] != expected[1:]:
        raise InputError(
            f"{path}: {got[2]}x{got[1]} pixels, {CAPTURE_FILE} says {expected[2]}x{expected[1]}; "
            "correct the camera's w and h (and fl_x, fl_y, cx, cy with them)"
        )
    if got[0] < expected[0]:
        raise InputError(f"{path}: {got[0]} frames, {CAPTURE_FILE} says {expected[0]}; correct `frames`")


def read_mesh(path: Path) -> trimesh.Trimesh:
    """Triangles of a mesh file, vertices as in the file.

    Raises:
        InputError: no such file, an unreadable one, or one without triangles.
    """
    import trimesh  # slow to load

    try:
        mesh = trimesh.load(path, force="mesh", process=False)
    except Exception as error:  # trimesh's readers raise any exception on broken files
        raise InputError(f"{path}: not a readable mesh ({type(error).__name__}: {error})") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise InputError(f"{path}: holds no triangles")
    return mesh
