"""How far a piece of work has come, and the bar that shows it."""

from __future__ import annotations

from collections.abc import Callable

from tqdm import tqdm

Report = Callable[[str, int, int], None]
"""Called with the name of the work, the number done and the total."""


class ProgressBar:
    """One bar on a terminal per kind of work, closed at the end of the block."""

    def __init__(self) -> None:
        self._bar: tqdm | None = None
        self._total = 0

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def report(self, name: str, done: int, total: int) -> None:
        """Move the bar; another total begins a new one."""
        if self._bar is None or self._total != total:
            if self._bar is not None:
                self._bar.close()
            self._bar, self._total = tqdm(total=total, dynamic_ncols=True), total
        self._bar.set_description(name, refresh=False)
        self._bar.update(done - self._bar.n)
