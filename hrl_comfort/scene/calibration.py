"""Factory calibration of an arm of Universal Robots, from its controller's file `calibration.conf`.

The file holds deltas of the DH parameters. On the controller it is `~/.urcontrol/calibration.conf` of its root user.
"""

from __future__ import annotations

import ast
import math
from configparser import ConfigParser, Error
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hrl_comfort.config import ConfigError
from hrl_comfort.files.reading import read_text
from hrl_comfort.scene.ur import JOINTS, UR_ARMS, Deltas, Six, UrModel, link_poses

SECTION = "mounting"
MOST_BYTES = 10**6
FINISHED = 2
"""Value of `calibration_status` of a calibrated arm ("linearised")."""
FARTHEST_M, FARTHEST_RAD = 0.03, math.radians(3.0)
"""Largest plausible difference of a link from the nominal one; arms are some millimetres and milliradians off."""


def calibrated(arm: object, name: str, path: str) -> UrModel:
    """Return the arm `name` with the calibration in the file `path`.

    Raises:
      ConfigError: the arm is not of Universal Robots, or the file is damaged or of another arm.
    """
    said = f"robot.calibration={path!r}"
    if not isinstance(arm, UrModel):
        raise ConfigError(f"{said} is for robot.name={', '.join(UR_ARMS)}; robot.name is {name}")
    found = replace(arm, deltas=read_deltas(path))
    for joint, (place, turn, _), (at, axes, _) in zip(JOINTS, link_poses(found), link_poses(arm), strict=True):
        away, turned = float(np.linalg.norm(place - at)), float(Rotation.from_matrix(axes.T @ turn).magnitude())
        if not (away < FARTHEST_M and turned < FARTHEST_RAD):
            raise ConfigError(
                f"{said} moves the link of {joint} by {1e3 * away:.3g} mm and {math.degrees(turned):.3g} degrees; "
                f"no {name} is more than {1e3 * FARTHEST_M:g} mm and {math.degrees(FARTHEST_RAD):g} degrees off"
            )
    return found


def read_deltas(path: str) -> Deltas:
    """Return the deltas in a file `calibration.conf`.

    Raises:
      ConfigError: it cannot be read, or has other than six finite numbers for each of them.
    """
    said, parser = f"robot.calibration={path!r}", ConfigParser(inline_comment_prefixes=("#",), interpolation=None)
    try:
        parser.read_string(read_text(Path(path), MOST_BYTES))
    except (OSError, ValueError, Error) as error:
        raise ConfigError(f"{said} cannot be read: {' '.join(str(error).split())}") from error
    if not parser.has_section(SECTION):
        raise ConfigError(f"{said} has no section [{SECTION}]: it must be a calibration.conf")
    values = parser[SECTION]
    if (status := values.get("calibration_status", str(FINISHED))) != str(FINISHED):
        raise ConfigError(f"{said}: calibration_status is {status}; a calibrated arm has {FINISHED}")
    keys = {field.name: f"delta_{field.name.partition('_')[0]}" for field in fields(Deltas)}
    return Deltas(**{name: _six(said, key, values.get(key)) for name, key in keys.items()})


def _six(said: str, key: str, text: str | None) -> Six:
    try:
        numbers = [float(each) for each in ast.literal_eval(text or "")]
    except (TypeError, ValueError, SyntaxError, MemoryError, RecursionError):
        numbers = []
    if len(numbers) != len(JOINTS) or not all(map(math.isfinite, numbers)):
        raise ConfigError(f"{said}: {key} is {str(text)[:60]}; it must be a list of {len(JOINTS)} finite numbers")
    a, b, c, d, e, f = numbers
    return a, b, c, d, e, f
