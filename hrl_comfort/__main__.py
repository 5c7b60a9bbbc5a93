"""The installed command. At SIGINT it ends with exit code 130 and one line, during imports too."""

from __future__ import annotations

import io
import os
import signal
import sys
from types import FrameType
from typing import Any, NoReturn

INTERRUPTED = 128 + signal.SIGINT
"""Exit code of shells for a command that SIGINT has ended."""


def end(*_: object) -> NoReturn:
    """End the process at once, as interrupted."""
    os.write(sys.stderr.fileno(), b"hrl-comfort: interrupted\n")
    os._exit(INTERRUPTED)


def interrupt(_: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt; end the process in an import, which may turn that into other errors, and next time."""
    signal.signal(signal.SIGINT, end)
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            end()
        frame = frame.f_back
    raise KeyboardInterrupt


def unraisable(error: Any) -> None:
    """Report an error that cannot propagate, for example out of `__del__`; end the process at KeyboardInterrupt."""
    if isinstance(error.exc_value, KeyboardInterrupt):
        end()
    sys.__unraisablehook__(error)


def prepare_streams() -> None:
    """Open the standard streams that are closed, whose numbers other files would get; let each say any text."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
            setattr(sys, name, open(number, "w" if number else "r"))  # noqa: SIM115  as long as the process
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def console() -> NoReturn:
    """Run as the installed command."""
    prepare_streams()
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else it is ignored, as under nohup
        signal.signal(signal.SIGINT, interrupt)
        sys.unraisablehook = unraisable
    import warnings

    from hrl_comfort.cli.completion import complete
    from hrl_comfort.cli.main import main

    complete()
    os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")  # TorchRL reports on every buffer that it allocates
    warnings.formatwarning = lambda message, *_, **__: f"hrl-comfort: {message}\n"
    try:
        code = main()
        sys.stdout.flush()
    except BrokenPipeError:  # whoever read along has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    except BaseException:
        if signal.getsignal(signal.SIGINT) is end:  # C code may turn KeyboardInterrupt into any error
            end()
        raise
    sys.exit(INTERRUPTED if signal.signal(signal.SIGINT, end) is end else code)


if __name__ == "__main__":
    console()
