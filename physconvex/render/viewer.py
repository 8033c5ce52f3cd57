"""A field in the browser: the soft convexes drawn by the rasteriser, or their hulls as a mesh (viser)."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from physconvex.convex import ConvexField, hull_mesh, read_ply
from physconvex.errors import InputError
from physconvex.render.movies import FIELD_OF_VIEW, orbit
from physconvex.render.rasterize import render
from physconvex.render.reference import LEAST_ALPHA
from physconvex.render.view import View

SOFT, HULLS = "soft convexes", "hulls"
STILL = 0.2  # seconds until a camera counts as at rest and the picture is drawn in full resolution
COARSE = 3  # times fewer pixels each way while it moves


def read_fields(source: str | Path) -> list[tuple[str, ConvexField]]:
    """The field of a PLY file, or of a folder: its field.ply, else all its PLY files by name, as frames.

    Raises:
        InputError: no such file or folder, or files without a field.
    """
    source = Path(source)
    if source.is_dir():
        whole = source / "field.ply"
        files = [whole] if whole.is_file() else sorted(source.glob("*.ply"))
        if not files:
            raise InputError(
                f"field: {source} holds no .ply file; name a field or a result of `physconvex reconstruct`"
            )
    elif source.is_file():
        files = [source]
    else:
        raise InputError(f"field: {source} does not exist; expected field.ply or a folder with it")
    return [(file.stem, read_ply(file)) for file in files]


@torch.no_grad()
def draw_view(
    field: ConvexField,
    *,
    position: Float[np.ndarray, " 3"],
    wxyz: Float[np.ndarray, " 4"],
    field_of_view: float,
    width: int,
    height: int,
) -> UInt8[np.ndarray, "height width 3"]:
    """A picture on white for a browser's camera.

    Args:
        position: of the camera [m].
        wxyz: unit quaternion of its axes right, down, forward in the world.
        field_of_view: vertical [rad].
        width, height: [pixels].
    """
    turn = Rotation.from_quat(wxyz, scalar_first=True).as_matrix()
    focal = 0.5 * height / np.tan(0.5 * field_of_view)
    view = View(
        width,
        height,
        torch.tensor([focal, focal]),
        torch.tensor([0.5 * width, 0.5 * height]),
        torch.as_tensor(turn * [1, -1, -1]),  # axes right, up, backward
        torch.as_tensor(np.array(position, dtype=np.float64)),
        torch.zeros(2),
    ).to(field.points.dtype)
    image = render(field, view).colour.clamp(0, 1)
    return (255 * image).round().byte().numpy()


class FieldViewer:
    """A server that shows fields to every browser that opens its address; runs until `close`.

    Attributes:
        server: the `viser.ViserServer`.
    """

    def __init__(
        self, fields: Sequence[tuple[str, ConvexField]], *, host: str = "127.0.0.1", port: int = 8080, size: int = 720
    ) -> None:
        """Start serving.

        Args:
            fields: names and fields; several are frames that a slider goes through.
            host: address to listen on; 0.0.0.0 lets other machines in.
            port: the first port to try.
            size: longest edge of the pictures [pixels].

        Raises:
            InputError: viser is not installed, no fields, or none with convexes.
        """
        try:
            import viser
        except ImportError:
            raise InputError("view: viser is not installed; run: pip install 'physconvex[viewer]'") from None
        if not fields or not all(len(field) for _, field in fields):
            raise InputError(f"view: got {len(fields)} fields; expected at least one, each with convexes")
        self._fields = [(name, field.to(torch.float32)) for name, field in fields]
        self._size = size
        self._frame, self._look = 0, SOFT
        self._wake: dict[int, threading.Event] = {}
        self._closed = False
        self.server: Any = viser.ViserServer(host=host, port=port, label="physconvex", verbose=False)
        self._place_camera()
        self._add_controls()
        self.server.on_client_connect(self._greet)
        self.server.on_client_disconnect(self._forget)

    @property
    def address(self) -> str:
        """Address to open."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def close(self) -> None:
        """Stop serving."""
        self._closed = True
        self._changed()
        self.server.stop()

    def _place_camera(self) -> None:
        """Where browsers look from at first."""
        field = self._fields[0][1]
        camera = orbit(field, 1)[0]
        points = field.points.reshape(-1, 3).numpy()
        start = self.server.initial_camera
        start.position = tuple(camera.position)
        start.look_at = tuple(0.5 * (points.min(axis=0) + points.max(axis=0)).astype(float))
        start.up = (0.0, 0.0, 1.0)
        start.fov = FIELD_OF_VIEW
        self.server.scene.set_up_direction("+z")

    def _add_controls(self) -> None:
        """Controls for the displayed object and frame."""
        look = self.server.gui.add_dropdown("show", (SOFT, HULLS), initial_value=SOFT)

        @look.on_update
        def _(_: Any) -> None:
            self._look = look.value
            self._changed()

        if len(self._fields) > 1:
            frame = self.server.gui.add_slider("frame", 0, len(self._fields) - 1, 1, 0)

            @frame.on_update
            def _(_: Any) -> None:
                self._frame = int(frame.value)
                self._changed()

    def _changed(self) -> None:
        if self._look == HULLS and not self._closed:
            field = self._fields[self._frame][1]
            mesh = hull_mesh(field.select(field.opacity >= LEAST_ALPHA))
            self.server.scene.add_mesh_trimesh("/hulls", mesh)
        elif not self._closed:
            self.server.scene.remove_by_name("/hulls")
        for event in list(self._wake.values()):
            event.set()

    def _greet(self, client: Any) -> None:
        """Draw for a new browser whenever its camera has moved."""
        event = self._wake[client.client_id] = threading.Event()
        client.camera.on_update(lambda _: event.set())
        event.set()
        threading.Thread(target=self._serve, args=(client, event), daemon=True).start()

    def _forget(self, client: Any) -> None:
        """A browser has gone."""
        self._wake.pop(client.client_id, None)

    def _serve(self, client: Any, event: threading.Event) -> None:
        """Coarse pictures while the camera moves, a full one at rest."""
        while not self._closed and self._wake.get(client.client_id) is event:
            if not event.wait(timeout=1.0):
                continue
            event.clear()
            self._send(client, self._size // COARSE)
            if not event.wait(timeout=STILL):
                self._send(client, self._size)

    def _send(self, client: Any, size: int) -> None:
        """One picture behind the rest of the browser's scene."""
        if self._closed:
            return
        if self._look == HULLS:
            client.scene.set_background_image(None)
            return
        camera = client.camera
        longest = max(camera.aspect, 1.0)
        width, height = (max(8, round(size * edge / longest)) for edge in (camera.aspect, 1.0))
        picture = draw_view(
            self._fields[self._frame][1],
            position=np.array(camera.position),
            wxyz=np.array(camera.wxyz),
            field_of_view=float(camera.fov),
            width=width,
            height=height,
        )
        client.scene.set_background_image(picture, format="jpeg", jpeg_quality=90)
