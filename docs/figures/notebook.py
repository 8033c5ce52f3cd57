"""The notebook of the examples: the first blocks of two tutorials, executed, with what they print and draw.

    python docs/figures/notebook.py                  # writes examples/first_steps.ipynb

The cells are those of the tutorials; `tests/test_docs.py` compares them.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import re
from pathlib import Path
from typing import Any

import matplotlib

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "examples" / "first_steps.ipynb"
CELLS = (
    (
        "# First steps\n\nThis notebook predicts one clip and refines one capture. Its code is that of the tutorials."
        "\n\n## Predict from a clip",
        ("predict", 0),
    ),
    ("A notebook displays a result as a table and a picture:", ("predict", 1)),
    ("The truth of this clip is known:", ("predict", 2)),
    (
        "## Refine a capture\n\nA silicone beam, clamped at one end, is released under its own weight. The reduced "
        "model alone takes about half a minute.",
        ("refine", 0),
    ),
    ("The same for a refinement:", ("refine", 1)),
    (
        "Dots are the recording, the line is the model. Frames to the right of the dotted line are not fitted.",
        ("refine", 2),
    ),
)


def code_of(page: str, number: int) -> str:
    """A Python block of a tutorial."""
    text = (ROOT / "docs" / "tutorials" / f"{page}.md").read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)[number].rstrip()


def executed(code: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    """What a cell prints, the value of its last line, and its figures."""
    import matplotlib.pyplot as plt

    tree, printed, value = ast.parse(code), io.StringIO(), None
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "cell", "exec"), names)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        outputs.append({"output_type": "stream", "name": "stdout", "text": printed.getvalue()})
    if hasattr(value, "_repr_html_"):
        data = {"text/html": value._repr_html_(), "text/plain": type(value).__name__}
        outputs.append({"output_type": "execute_result", "execution_count": None, "metadata": {}, "data": data})
    for number in plt.get_fignums():
        picture = io.BytesIO()
        plt.figure(number).savefig(picture, format="png", dpi=80)
        data = {"image/png": base64.b64encode(picture.getvalue()).decode(), "text/plain": "<Figure>"}
        outputs.append({"output_type": "display_data", "metadata": {}, "data": data})
    plt.close("all")
    return outputs


def main() -> None:
    """Run the cells and write the notebook."""
    matplotlib.use("Agg")
    os.chdir(ROOT)
    names: dict[str, Any] = {"__name__": "__main__"}
    cells: list[dict[str, Any]] = []
    for count, (text, place) in enumerate(CELLS, 1):
        code = code_of(*place)
        outputs = executed(code, names)
        for output in outputs:
            if "execution_count" in output:
                output["execution_count"] = count
        cells.append({"cell_type": "markdown", "id": f"text-{count}", "metadata": {}, "source": text})
        cells.append(
            {"cell_type": "code", "id": f"code-{count}", "metadata": {}, "execution_count": count, "source": code,
             "outputs": outputs}
        )  # fmt: skip
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    content = {"cells": cells, "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
               "nbformat": 4, "nbformat_minor": 5}  # fmt: skip
    NOTEBOOK.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
