"""Objects from the user's mesh files."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from data_gen.objects.library import ObjectMesh
from physconvex import InputError

SUFFIXES = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
TEXTURE_NAMES = (
    "texture.png",
    "texture.jpg",
    "{stem}.png",
    "{stem}.jpg",
    "{stem}_texture.png",
    "*_texture.png",
)
LICENCE_NAMES = ("LICENSE.txt", "LICENSE", "LICENSE.md", "LICENCE.txt", "LICENCE")


def load_user_mesh(path: str | Path, *, texture: str | Path | None = None, name: str | None = None) -> ObjectMesh:
    """Read an OBJ, PLY, GLB, STL or OFF file with its texture or vertex colours; z is up.

    glTF files, whose y axis is up, are turned. Units and place are those of the file; `ObjectMesh.scaled` changes
    them. The texture is the given one, else that of the file, else `texture.png`, `<name of the file>.png` or the only
    `*_texture.png` beside it. A licence file beside the mesh or one folder up is quoted by its first line.

    Args:
        path: the mesh file.
        texture: image file; needs texture coordinates in the mesh.
        name: name of the object; default: the folder and the file, with a checksum of the geometry.

    Raises:
        InputError: the file is missing, unreadable or holds no triangles, or the texture does not fit.
    """
    import trimesh

    path = Path(path)
    if not path.is_file():
        raise InputError(f"path: {path} is not a file; expected a mesh ({', '.join(SUFFIXES)})")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"path: {path} ends in {path.suffix!r}; expected one of {', '.join(SUFFIXES)}")
    try:
        mesh = trimesh.load_mesh(path, process=False)
    except Exception as error:  # trimesh raises many types, depending on the format
        raise InputError(f"path: {path} cannot be read as a mesh ({error}); export it again") from error
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise InputError(f"path: {path} holds {len(faces)} triangles of {len(vertices)} vertices; expected a surface")
    if path.suffix.lower() in (".glb", ".gltf"):
        vertices = vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
    uv, image = _texture_of(mesh.visual, path, None if texture is None else Path(texture))
    digest = hashlib.sha256(vertices.tobytes() + faces.tobytes()).hexdigest()[:12]
    return ObjectMesh(
        vertices=vertices,
        faces=faces,
        name=f"{path.parent.name}/{path.stem}-{digest}" if name is None else name,
        family="user",
        vertex_colors=_colors_of(mesh.visual, len(vertices)) if image is None else None,
        uv=uv if image is not None else None,
        texture=image,
        licence=_licence_near(path),
    )


def objects_from_folder(folder: str | Path) -> list[Path]:
    """Mesh files under `folder` and its subfolders, sorted; load them with `load_user_mesh` when needed.

    Raises:
        InputError: `folder` is no folder, or there is no mesh in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"folder: {folder} is not a folder; expected one with meshes ({', '.join(SUFFIXES)})")
    paths = sorted(p for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES and p.is_file())
    if not paths:
        raise InputError(f"folder: no mesh in {folder}; expected files ending in {', '.join(SUFFIXES)}")
    return paths


def _texture_of(visual: Any, path: Path, given: Path | None) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Texture coordinates and image (sRGB bytes) of a mesh, or None for both."""
    uv = getattr(visual, "uv", None)
    if uv is None:
        if given is not None:
            raise InputError(f"texture: {path} has no texture coordinates; expected some for {given}")
        return None, None
    if given is not None and not given.is_file():
        raise InputError(f"texture: {given} is not a file; expected an image")
    material = getattr(visual, "material", None)
    image = None if given is not None else getattr(material, "image", None)
    image = getattr(material, "baseColorTexture", None) if image is None and given is None else image
    if image is not None and not (path.suffix.lower() == ".obj" and max(image.size) <= 2):  # else a placeholder
        return np.asarray(uv, dtype=np.float64), np.asarray(image.convert("RGB"), dtype=np.uint8)
    beside = given or _texture_beside(path)
    return (None, None) if beside is None else (np.asarray(uv, dtype=np.float64), _read_image(beside))


def _texture_beside(path: Path) -> Path | None:
    for pattern in TEXTURE_NAMES:
        found = sorted(path.parent.glob(pattern.format(stem=path.stem.replace("[", "[[]"))))
        if len(found) == 1:
            return found[0]
    return None


def _read_image(path: Path) -> np.ndarray:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"), dtype=np.uint8)
    except (UnidentifiedImageError, OSError) as error:
        raise InputError(f"texture: {path} cannot be read as an image ({error})") from error


def _colors_of(visual: Any, count: int) -> np.ndarray | None:
    """Vertex colours [V, 3] of the file, or None where it has none."""
    if getattr(visual, "kind", None) != "vertex":
        return None
    colors = np.asarray(visual.vertex_colors)[:, :3].astype(np.uint8)
    return colors if len(colors) == count else None


def _licence_near(path: Path) -> str | None:
    """First line of a licence file beside the mesh, or one folder up."""
    for folder in (path.parent, path.parent.parent):
        for name in LICENCE_NAMES:
            if (folder / name).is_file():
                lines = (folder / name).read_text(encoding="utf-8", errors="replace").strip().splitlines()
                return lines[0][:500] if lines else None
    return None
