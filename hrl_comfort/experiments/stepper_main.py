"""The process of a `StepperApart`: (question, *about) come in, and `stepper_answers` has the answers."""

from __future__ import annotations

import os
import pickle
import select
import signal
import threading
import traceback
import warnings

ALONE = 3
"""The exit code when whoever asks is gone; 1 is that of an error."""


def main() -> None:
    """Answer the process that started this one, until that is gone."""
    asked, told = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)  # whatever else is read
    os.dup2(2, 1)  # or printed
    threading.Thread(target=_end_with, args=(asked.fileno(),), daemon=True).start()
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # without a word, should whoever asked be gone
    warnings.formatwarning = lambda message, *_, **__: f"hrl-comfort: {message}\n"
    from hrl_comfort.experiments.stepper_answers import Answers  # takes seconds

    answers = Answers()
    while True:
        try:
            question, *about = pickle.load(asked)
        except (EOFError, pickle.UnpicklingError):  # in the middle of a question, maybe
            return
        said: object
        try:
            said = answers.to[question](*about)
        except Exception as error:  # noqa: BLE001  it is raised where the answer is waited for
            said = _sent(error)
        pickle.dump(said, told, pickle.HIGHEST_PROTOCOL)
        told.flush()


def _end_with(pipe: int) -> None:
    """End this process, whatever it does, as soon as nobody can write into `pipe` any more."""
    poll = select.poll()
    poll.register(pipe, 0)  # which leaves the end of it
    poll.poll()
    os._exit(ALONE)


def _sent(error: Exception) -> Exception:
    """Return what of an error arrives: its kind if that can be made again, and where it was raised."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001  whatever hinders it
        error = RuntimeError(f"{type(error).__name__}: {error}")
    error.add_note(traceback.format_exc())  # tracebacks cannot be sent
    return error


if __name__ == "__main__":
    main()
