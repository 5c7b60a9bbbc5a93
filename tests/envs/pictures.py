"""Pictures in tests: skipped where nothing can be drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from hrl_comfort.scene.camera import PicturesUnavailableError


def drawn(draw: Callable[[], Any]) -> Any:
    """Return what `draw` does; skip the test where there is no off-screen OpenGL."""
    try:
        return draw()
    except PicturesUnavailableError as error:
        pytest.skip(str(error))
