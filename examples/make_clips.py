"""Make the clips of `examples/clips`: scanned toys, dropped on a floor by the finite elements, filmed from the front.

    python examples/make_clips.py --objects FOLDER [--out examples/clips] [--sheet sheet.png]

FOLDER holds Google Scanned Objects, one folder each with `model.obj` and `texture.png`. The objects are enlarged to a
largest edge of 1 m, since `physconvex predict` assumes that size unless told otherwise.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from data_gen import (
    Backdrop,
    GeneratorConfig,
    draw_degradation,
    draw_drop,
    draw_look,
    floor_texture,
    load_config,
    prepare_surface,
    render_view,
    simulate_drop,
)
from physconvex.io import write_video

SIZE = 1.0  # largest edge of the rest bounding box [m]
SHEET_FRAMES = (0, 4, 8, 10, 12, 14, 18, 23)


@dataclass(frozen=True)
class Clip:
    """One clip: folder of the object, Young's modulus [Pa], Poisson's ratio, seed of pose, camera and light, colours
    (sRGB) of the wall and of the floor."""

    name: str
    folder: str
    youngs_modulus: float
    poisson_ratio: float
    seed: int
    wall: tuple[int, int, int]
    floor: tuple[int, int, int]


CLIPS = (
    Clip("lion", "Schleich_Lion_Action_Figure", 5e5, 0.42, 1, (196, 206, 214), (120, 116, 110)),
    Clip("mario", "Nintendo_Mario_Action_Figure", 1e5, 0.35, 2, (226, 218, 200), (150, 124, 96)),
    Clip("dinosaur", "Dino_4", 2e5, 0.45, 3, (168, 182, 170), (104, 110, 118)),
    Clip("rhinoceros", "Schleich_African_Black_Rhino", 3e6, 0.30, 4, (214, 196, 178), (168, 150, 120)),
    Clip("kong", "Kong_Puppy_Teething_Rubber_Small_Pink", 3e4, 0.25, 5, (150, 164, 188), (132, 136, 128)),
)


def clip_config(clip: Clip, objects: Path) -> GeneratorConfig:
    """The generator's configuration for one clip: large images, little degraded."""
    return load_config(
        overrides=[
            f"objects.folder={objects / clip.folder}",
            f"material.youngs_modulus={clip.youngs_modulus}",
            f"material.poisson_ratio={clip.poisson_ratio}",
            "motion.drop_height=[0.3, 0.7]",
            "motion.initial_spin=[0.0, 1.0]",
            "solver.target_nodes=700",
            "solver.steps_per_frame=24",
            "video={width: 448, height: 448, crf: 21}",
            "camera={views: 1, elevation_deg: [6, 14], field_of_view_deg: [30, 42], azimuth_deg: [-35, 35], "
            "margin: [1.03, 1.08]}",
            "degradation={noise_share: 1.0, noise: 0.004, compression_share: 0.0, blur_share: 1.0, shutter: 0.3, "
            "exposure_share: 1.0, exposure_stops: [-0.15, 0.15], white_balance: [-0.03, 0.03], gamma: [0.95, 1.05], "
            "shake_share: 0.0}",
        ]
    )


def room(clip: Clip, rng: np.random.Generator) -> Backdrop:
    """A floor of the clip's colour with a procedural pattern before a wall that is darker below."""
    pattern = floor_texture(rng, 256).astype(np.float64)
    floor = np.array(clip.floor) * (0.6 + 0.4 * pattern.mean(axis=-1, keepdims=True) / pattern.mean())
    shade = np.linspace(1.0, 0.8, 64)[:, None, None]
    wall = np.broadcast_to(np.array(clip.wall) * shade, (64, 8, 3))
    return Backdrop(np.clip(floor, 0, 255).astype(np.uint8), wall.astype(np.uint8), floor_tile=2.0)


def make_clip(clip: Clip, objects: Path) -> tuple[np.ndarray, dict[str, object]]:
    """Frames, uint8 [T, H, W, 3], and true values of one clip."""
    config = clip_config(clip, objects)
    turned = draw_drop(config, clip.seed, 0, 0)
    scale = SIZE * turned.body.size / turned.size
    motion = config.motion.model_validate(config.motion.model_dump() | {"size": scale})
    config = config.model_copy(update={"motion": motion})
    drop = draw_drop(config, clip.seed, 0, 0)
    rng = np.random.default_rng(clip.seed)
    simulated = simulate_drop(drop, config, rng)
    prepare_surface(drop, config, rng)
    look = replace(draw_look(config, rng, simulated.surface, name="front"), backdrop=room(clip, rng))
    degradation = draw_degradation(config.degradation, rng, config.video.crf)
    frames, _ = render_view(simulated, look, degradation, config, rng)
    truth = {
        "object": clip.folder,
        "youngs_modulus": drop.youngs_modulus,
        "poisson_ratio": drop.poisson_ratio,
        "density": drop.density,
        "object_size": drop.size,
        "fps": config.video.fps,
        "friction": drop.friction,
        "damping_time": drop.damping_time,
        "nodes": len(simulated.mesh.vertices),
    }
    return frames, truth


def main() -> None:
    """Write the clips, their true values and, if asked, a picture of some frames."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--objects", type=Path, required=True, help="folder of Google Scanned Objects")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "clips")
    parser.add_argument("--sheet", type=Path, help="picture with some frames of every clip")
    parser.add_argument("--only", nargs="*", help="names of the clips to make (default: all)")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    arguments.out.mkdir(parents=True, exist_ok=True)
    path, rows = arguments.out / "truth.json", []
    truth = json.loads(path.read_text()) if path.exists() else {}
    for clip in CLIPS:
        if arguments.only and clip.name not in arguments.only:
            continue
        frames, truth[f"{clip.name}.mp4"] = make_clip(clip, arguments.objects)
        write_video(arguments.out / f"{clip.name}.mp4", frames, fps=24.0, crf=21)
        rows.append(np.concatenate([frames[k][::2, ::2] for k in SHEET_FRAMES], axis=1))
        size = (arguments.out / f"{clip.name}.mp4").stat().st_size
        print(f"{clip.name}: {len(frames)} frames, {size / 1000:.0f} kB")
    path.write_text(json.dumps(truth, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    if arguments.sheet:
        Image.fromarray(np.concatenate(rows)).save(arguments.sheet)


if __name__ == "__main__":
    main()
