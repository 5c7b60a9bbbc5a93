"""`python -m tests.adversary MUTATIONS COMMANDS [USER]`: damaged artefacts and hostile command lines (`make fuzz`).

Each is a process of its own: a fork of this one, which has imported everything, with the rights of USER (an id; by
default one's own). It passes if its exit code is 0, or 1 with one line, if it takes at most LIMIT_S of a processor and
MEMORY_BYTES more than this process, and if it changes no file that the program did not make. SEED draws others.
"""

from __future__ import annotations

import collections
import contextlib
import hashlib
import os
import random
import re
import resource
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any, NoReturn

import torch

from hrl_comfort.cli.main import main
from tests.artefacts import READ, make
from tests.damage import damage
from tests.hostile import hostile

LIMIT_S = 20
PATIENCE_S = 600
"""Time by the clock after which a command hangs, however busy the machine is."""
MEMORY_BYTES = 2 * 10**9
NO_MORE_BYTES = 6 * 10**9
"""Limit of a process, so that this machine survives a fault."""
OUTPUT = re.compile(r"\.?(out|stopped)")
"""Names that the commands write, in the folder of a case."""
MADE = re.compile(r"\.?(out|stopped|run|sweep|tables|controller)")
"""Names that the program has made there."""


class Adversary:
    """Runs commands in folders with artefacts; `counts` and `most` are of all cases so far."""

    def __init__(self, template: Path, user: int | None = None) -> None:
        self._template, self.user = template, os.getuid() if user is None else user
        self.counts: collections.Counter[str] = collections.Counter()
        self.most: dict[str, float] = collections.defaultdict(float)

    @contextlib.contextmanager
    def folder(self) -> Any:
        """Copy the artefacts to a folder of the user, and enter it."""
        with tempfile.TemporaryDirectory(prefix="case", ignore_cleanup_errors=True) as name, contextlib.chdir(name):
            subprocess.run(["cp", "-a", f"{self._template}/.", "."], check=True)
            yield

    def mutation(self, verb: str, rng: random.Random) -> tuple[str, list[str]]:
        """Damage an artefact that a verb reads, and run it; return what was done and the faults."""
        words, files = READ[verb]
        with self.folder():
            file = rng.choice(files)
            what = f"{verb}: {file} {damage(Path(file), rng)}"
            return what, self.faults(words, OUTPUT)

    def command(self, rng: random.Random) -> tuple[str, list[str]]:
        """Run a hostile command line; return it and the faults."""
        words = hostile(rng)
        with self.folder():
            return ascii(" ".join(words))[:300], self.faults(words, MADE)

    def faults(self, words: list[str], may_change: re.Pattern[str]) -> list[str]:
        """Run a command in a process of its own; return its faults."""
        if self.user != os.getuid():
            subprocess.run(["chown", "-hR", f"{self.user}:{self.user}", "."], check=True)
        before, begin, mine = snapshot(may_change), time.monotonic(), resident_bytes()
        with tempfile.TemporaryFile() as log:
            pid = os.fork()
            if not pid:
                self._child(words, log.fileno())
            done = 0
            while not done:
                done, status, usage = os.wait4(pid, os.WNOHANG)
                if not done and time.monotonic() - begin > PATIENCE_S:
                    os.kill(pid, signal.SIGKILL)
                time.sleep(0.01)
            log.seek(0)
            said = log.read().decode(errors="replace")
        code, seconds = os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime
        after, last = snapshot(may_change), said.strip().splitlines()[-1:]
        found = []
        if "Traceback" in said or code not in (0, 1, 130):
            found.append(f"exit code {code}: {' | '.join(said.strip().splitlines()[-3:])[-600:]}")
        elif code == 1 and not (last and last[0].startswith("hrl-comfort: ") and len(last[0]) < 1100):
            found.append(f"not one line: {said[-300:]!r}")
        if seconds > LIMIT_S or code == -signal.SIGKILL:
            found.append(f"{seconds:.0f} s of a processor, {time.monotonic() - begin:.0f} s")
        if (own := usage.ru_maxrss * 1024 - mine) > MEMORY_BYTES:
            found.append(f"{own / 1e9:.1f} GB")
        if changed := [name for name in before if after.get(name) != before[name]]:
            found.append(f"changed {changed[:3]}")
        self.counts["refused" if code == 1 else "done"] += 1
        for name, value in {"processor s": seconds, "MB": usage.ru_maxrss / 1e3}.items():
            self.most[name] = max(self.most[name], round(value, 1))
        return found

    def _child(self, words: list[str], log: int) -> NoReturn:
        code = 99
        try:
            sys.stdout = sys.stderr = os.fdopen(log, "w", buffering=1, errors="replace")
            os.dup2(log, 1)
            os.dup2(log, 2)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            resource.setrlimit(resource.RLIMIT_CPU, (2 * LIMIT_S, 2 * LIMIT_S))
            resource.setrlimit(resource.RLIMIT_DATA, (NO_MORE_BYTES, NO_MORE_BYTES))
            if self.user != os.getuid():
                os.setgroups([])
                os.setgid(self.user)
                os.setuid(self.user)
            code = run(words)
        except BaseException:  # noqa: BLE001  what main does not catch is a fault
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(code)


def resident_bytes() -> int:
    """Return the memory of this process, which every fork begins with."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def snapshot(may_change: re.Pattern[str]) -> dict[str, object]:
    """Return kind and digest of every file in the working directory that must not change.

    Content that is kept would count for the memory of the process that is forked next.
    """
    found: dict[str, object] = {}
    for path in Path().rglob("*"):
        if not may_change.match(str(path)) and (path.is_symlink() or not path.is_dir()):
            about = path.lstat()
            content: object = path.is_symlink() and os.readlink(path)
            if stat.S_ISREG(about.st_mode):
                with path.open("rb") as file:
                    content = hashlib.file_digest(file, "sha256").hexdigest()
            found[str(path)] = (about.st_mode, about.st_rdev, content)
    return found


def run(words: list[str]) -> int:
    """Run a command; of a replay in the studio, what reads the recording alone."""
    from hrl_comfort.studio import server
    from hrl_comfort.studio.replay import tape

    def read(config: Any) -> NoReturn:
        for recording in tape(Path(config.replay)).recordings:
            assert recording.duration_s is not None
        raise KeyboardInterrupt

    server.ReplayStudio = read  # type: ignore[assignment,misc]
    return main(words)


def all_cases(adversary: Adversary, mutations: int, commands: int, seed: int) -> int:
    """Run the cases; print faults and counts; return the number of faults."""
    rng, verbs, bad = random.Random(seed), [*READ], 0
    for number in range(mutations + commands):
        mutates = number < mutations
        what, faults = adversary.mutation(verbs[number % len(verbs)], rng) if mutates else adversary.command(rng)
        bad += bool(faults)
        for fault in faults:
            print(f"{number}: {what}: {fault}", flush=True)
        if number % 50 == 49 or number + 1 == mutations + commands:
            counted = f"{dict(adversary.counts)}, most {dict(adversary.most)}"
            print(f"{number + 1} cases (of them {min(number + 1, mutations)} mutations): {bad} faulty, {counted}")
    return bad


if __name__ == "__main__":
    torch.set_num_threads(1)
    given = [int(word) for word in sys.argv[1:]]
    with tempfile.TemporaryDirectory(prefix="artefacts", ignore_cleanup_errors=True) as template:
        make(Path(template))
        adversary = Adversary(Path(template), *given[2:])
        with Adversary(Path(template)).folder():
            for words, _ in READ.values():  # what these import and compute, the forks share
                shutil.rmtree("out", ignore_errors=True)
                assert run(words) in (0, 130), words
        sys.exit(all_cases(adversary, given[0], given[1], int(os.environ.get("SEED", "0"))) > 0)
