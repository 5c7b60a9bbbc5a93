"""`hrl-comfort doctor`: what an issue should say about the machine, and what is missing on it."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version

from hrl_comfort import __version__

EXTRAS = ("", "gymnasium", "sb3", "studio", "streams", "export", "ur", "wandb", "submitit", "ray", "optuna")
"""Those whose packages are listed; the empty one stands for what every installation has."""
PIN = re.compile(r"([\w.-]+)(?:\[\w+\])?==([^;\s]+)(?:.*extra == ['\"]([\w-]+)['\"])?")


def report() -> str:
    """Return a Markdown table for an issue: versions, extras, off-screen drawing, streams, cores and memory."""
    lines = {
        "part": "found",
        "---": "---",
        "hrl-comfort": f"{__version__}, Python {platform.python_version()}, {platform.platform()}",
        "cores": f"{_usable_cores()} of {os.cpu_count()} usable",
        "memory": f"{os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') / 2**30:.1f} GiB",
        **{f"extra {extra}" if extra else "packages": ", ".join(_packages(extra)) for extra in EXTRAS},
        "off-screen drawing": _drawing(),
        "Lab Streaming Layer": _streams(),
    }
    return "".join(f"| {name} | {value} |\n" for name, value in lines.items())


def _usable_cores() -> int | None:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()


def _packages(extra: str) -> Iterator[str]:
    """Yield the packages of an extra with their versions, and the pin where another version is installed."""
    try:
        pins = [PIN.match(line) for line in requires("hrl-comfort") or ()]
    except PackageNotFoundError:
        yield "hrl-comfort is not installed: it runs from a checkout"
        return
    for name, wanted in [(pin[1], pin[2]) for pin in pins if pin is not None and (pin[3] or "") == extra]:
        try:
            here = version(name)
        except PackageNotFoundError:
            here = "missing"
        yield f"{name} {here}" + ("" if here.partition("+")[0] in (wanted, "missing") else f" (tested: {wanted})")


def _drawing() -> str:
    """Return whether off-screen OpenGL draws, or why it does not."""
    import mujoco

    from hrl_comfort.scene.camera import Camera, PicturesUnavailableError

    try:
        Camera(mujoco.MjModel.from_xml_string("<mujoco/>"), 0.0, 0.0, 1.0).close()
    except PicturesUnavailableError as error:
        return str(error)
    return f"works (MUJOCO_GL={os.environ.get('MUJOCO_GL', 'unset')})"


def _streams() -> str:
    try:
        import pylsl
    except (ImportError, RuntimeError) as error:
        return " ".join(str(error).split())
    return f"liblsl {pylsl.library_version() // 100}.{pylsl.library_version() % 100}"
