"""Display of results in a notebook: a table of numbers and a picture."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8

if TYPE_CHECKING:
    from jinja2 import Template

_TEMPLATE = """<div class="physconvex"><strong>{{ title }}</strong>
<table>{% for name, value in rows %}<tr><th style="text-align:left">{{ name }}</th>\
<td style="text-align:left">{{ value }}</td></tr>{% endfor %}</table>
{% for picture in pictures %}<div>{{ picture.element }}</div>{% endfor %}
{% if notes %}<ul>{% for note in notes %}<li>{{ note }}</li>{% endfor %}</ul>{% endif %}</div>
"""


@dataclass(frozen=True)
class Picture:
    """A picture within a page."""

    content: bytes | str
    """PNG or JPEG bytes, or an SVG element."""
    label: str = ""
    """Alternative text."""

    @property
    def element(self) -> str:
        """As HTML."""
        from markupsafe import Markup

        if isinstance(self.content, str):
            return Markup(self.content)
        return Markup('<img alt="{}" style="max-width:100%" src="{}">').format(self.label, data_uri(self.content))


def data_uri(image: bytes) -> str:
    """A PNG or JPEG file as an address that holds it."""
    kind = "png" if image[:4] == b"\x89PNG" else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(image).decode('ascii')}"


def png_bytes(image: UInt8[np.ndarray, "H W C"]) -> bytes:
    """An image as a PNG file."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="png")
    return buffer.getvalue()


@cache
def _template() -> Template:
    from jinja2 import Environment, StrictUndefined

    return Environment(autoescape=True, undefined=StrictUndefined).from_string(_TEMPLATE)


def html_summary(
    title: str, rows: Sequence[tuple[str, str]], *, pictures: Sequence[Picture] = (), notes: Sequence[str] = ()
) -> str:
    """A result as HTML for a notebook; all text is escaped.

    Args:
        title: heading.
        rows: names and values, with units.
        pictures: below the table.
        notes: such as warnings.
    """
    return _template().render(title=title, rows=rows, pictures=pictures, notes=notes)
