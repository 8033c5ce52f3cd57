"""Views that several tests share."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="session")
def seen():
    """Six views of the striped ball."""
    from tests.reconstruction.scenes import views

    return views(6)
