"""Picture of docs/concepts/convex_field.md: the viewer in a headless Chromium, showing the body of `convex.py`.

python docs/figures/viewer.py
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.append(str(Path(__file__).parents[2]))

from convex import blob, prisms

from physconvex.render import FieldViewer
from tests.convex.browser import screenshots

OUT = Path(__file__).parents[1] / "images" / "viewer.png"
SECONDS = 40.0
SHOWN = 20.0  # standard deviation of the pixels from which there is something to see


def main() -> None:
    """Wait until the picture stays as it is, and store it."""
    viewer = FieldViewer([("field", prisms(blob(), thickness=0.03, softness=0.004))], port=8433)
    last = np.zeros(1)
    try:
        with tempfile.TemporaryDirectory() as profile:
            for picture in screenshots(viewer.address, Path(profile), SECONDS):
                if picture.std() > SHOWN and picture.shape == last.shape and (picture == last).all():
                    break
                last = picture
    finally:
        viewer.close()
    if picture.std() <= SHOWN:
        raise SystemExit("the browser showed nothing")
    Image.fromarray(picture).save(OUT, optimize=True)


if __name__ == "__main__":
    main()
