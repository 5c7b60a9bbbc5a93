"""Pictures of the cells of an engine, and a window on one of them."""

import atexit
import threading
import weakref
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.scene.camera import Camera, PicturesUnavailableError
from hrl_comfort.scene.looks import dressed
from hrl_comfort.scene.workcell import CONTROL_SPEC
from hrl_comfort.sim.controls import pack_controls
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.objects import rendered_positions

AZIMUTH_DEG, ELEVATION_DEG, DISTANCE_M = 60.0, -45.0, 2.9
"""Of the camera: the places and the people around them are in sight."""
CLOSING_S = 30.0
"""Time that a window has to close."""


class View:
    """Pictures of an engine's cells; OpenGL starts with the first of them."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._camera: Camera | None = None
        self._window: Any = None

    @cached_property
    def _model(self) -> mujoco.MjModel:
        return dressed(self._engine.scene).model

    @cached_property
    def _data(self) -> mujoco.MjData:
        return mujoco.MjData(self._model)

    def picture(self, row: int = 0) -> NDArray[np.uint8]:
        """Return the picture (`scene.camera.HEIGHT`, WIDTH, 3) of a cell as it is now.

        Raises:
          PicturesUnavailableError: there is no off-screen OpenGL.
        """
        if self._camera is None:
            self._camera = Camera(self._model, AZIMUTH_DEG, ELEVATION_DEG, DISTANCE_M)
        self._put(row)
        return self._camera.picture(self._data)

    def show(self, row: int = 0) -> None:
        """Show a cell as it is now in MuJoCo's viewer.

        Raises:
          PicturesUnavailableError: there is no display.
        """
        if self._window is None:
            import glfw
            from mujoco import viewer

            if not glfw.init():
                raise PicturesUnavailableError(
                    "no window: there is no display here; choose render_mode='rgb_array', or set DISPLAY"
                )
            self._put(row)
            others = set(threading.enumerate())
            self._window = viewer.launch_passive(self._model, self._data, show_left_ui=False, show_right_ui=False)
            drawing = set(threading.enumerate()) - others
            self._close_window = weakref.finalize(self, _close, self._window, drawing)
            self._close_window.atexit = False
            atexit.register(self._close_window)  # it runs before the viewer's own exit handlers, which end GLFW
            camera = self._window.cam
            camera.azimuth, camera.elevation, camera.distance = AZIMUTH_DEG, ELEVATION_DEG, DISTANCE_M
        if self._window.is_running():  # nobody has closed it
            with self._window.lock():
                self._put(row)
            self._window.sync()

    def close(self) -> None:
        """Close the window and free OpenGL."""
        if self._window is not None:
            self._close_window()
        if self._camera is not None:
            self._camera.close()
        self._window = self._camera = None

    def _put(self, row: int) -> None:
        """Put a cell's arm, human and objects where they are now into the data."""
        engine, episodes, at = self._engine, self._engine.episodes, np.array([row])
        assert episodes.state is not None
        control = pack_controls(
            engine.scene,
            episodes.state.joint_target.numpy()[at, None],
            episodes.people.now.limbs[at],
            episodes.draw.layout(at),
            rendered_positions(episodes.state, episodes.subtask)[at],
            episodes.state.kinds.numpy()[at],
            episodes.draw.points[at, : episodes.subtask.points],
        )
        model, data = self._model, self._data
        mujoco.mj_setState(model, data, engine.physics.state[row], mujoco.mjtState.mjSTATE_FULLPHYSICS)
        mujoco.mj_setState(model, data, control[0, 0], CONTROL_SPEC)
        mujoco.mj_forward(model, data)


def _close(window: Any, drawing: set[threading.Thread]) -> None:
    """Close a window and wait for its threads, which must not draw when GLFW ends."""
    window.close()
    for thread in drawing:
        thread.join(CLOSING_S)
