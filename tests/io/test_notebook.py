"""How results show themselves in a notebook."""

import numpy as np

from physconvex.io import Picture, html_summary, png_bytes


def test_text_is_escaped_and_pictures_are_not():
    image = png_bytes(np.zeros((4, 6, 3), np.uint8))
    pictures = [Picture(image, 'a "ball"'), Picture("<svg></svg>")]
    page = html_summary("<title>", [("E & nu", "<1 Pa>")], pictures=pictures, notes=["a < b"])
    assert "&lt;title&gt;" in page and "E &amp; nu" in page and "&lt;1 Pa&gt;" in page and "a &lt; b" in page
    assert 'alt="a &#34;ball&#34;"' in page and "data:image/png;base64,iVBOR" in page and "<svg></svg>" in page
