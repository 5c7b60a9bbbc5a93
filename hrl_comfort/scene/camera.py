"""Off-screen pictures of a cell by MuJoCo's renderer."""

from __future__ import annotations

import atexit
import importlib
import os
import weakref
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 480, 360
PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri"
_BACKENDS = ("egl", "osmesa")
_MOST_SHAPES = 500


class PicturesUnavailableError(RuntimeError):
    """There is no way to draw: no OpenGL library or no display; the message names the remedy."""


class Camera:
    """A camera that looks at the robot's base from `distance_m`; angles as of `mujoco.MjvCamera`."""

    def __init__(self, model: mujoco.MjModel, azimuth_deg: float, elevation_deg: float, distance_m: float) -> None:
        """Open an off-screen OpenGL context.

        Raises:
          PicturesUnavailableError: there is none.
        """
        model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.35, 0.35
        model.vis.map.znear = 0.05 / model.stat.extent  # the extent holds what is put far away
        model.light_cutoff[:] = 85  # the lamp lights the whole floor
        self._screen = _open_screen()
        self._model = model
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        self.close = weakref.finalize(self, _free, self._screen, self._context)
        """Free the OpenGL context; a camera that is forgotten does so itself."""
        self.close.atexit = False
        atexit.register(self.close)  # it runs before mujoco.egl's own exit handler, which ends EGL
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._view, self._option = mujoco.MjvScene(model, maxgeom=_MOST_SHAPES), mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._camera.lookat[:] = (0.0, 0.0, 0.2)
        self._camera.azimuth, self._camera.elevation, self._camera.distance = azimuth_deg, elevation_deg, distance_m

    def picture(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        """Return the picture (HEIGHT, WIDTH, 3) of `data`, whose positions are up to date (`mj_forward`)."""
        self._screen.make_current()  # another camera may have drawn since
        rectangle = mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
        picture = np.empty((HEIGHT, WIDTH, 3), dtype=np.uint8)
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._camera, everything, self._view)
        mujoco.mjr_render(rectangle, self._view, self._context)
        mujoco.mjr_readPixels(picture, None, rectangle, self._context)
        return picture[::-1].copy()


def _free(screen: Any, context: mujoco.MjrContext) -> None:
    screen.make_current()
    context.free()
    screen.free()


def _open_screen() -> Any:
    """Return a current off-screen OpenGL context, EGL unless MUJOCO_GL says osmesa.

    It is made here, not by mujoco.Renderer, whose back end is fixed when mujoco is first imported.
    """
    asked = os.environ.get("MUJOCO_GL", "").lower()
    backend = asked if asked in _BACKENDS else "egl"
    try:
        screen = importlib.import_module(f"mujoco.{backend}").GLContext(WIDTH, HEIGHT)
        screen.make_current()
    except (ImportError, AttributeError, RuntimeError, OSError) as error:
        raise PicturesUnavailableError(
            f"no pictures: off-screen OpenGL ({backend}) is not available here ({type(error).__name__}); "
            f"on Debian or Ubuntu: apt-get install {PACKAGES}"
        ) from error
    return screen
