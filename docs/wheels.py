"""Check by pip's dry run that all pins install from wheels: every supported Python on every supported platform.

    python docs/wheels.py            # Python 3.11 and 3.12; some minutes
    python docs/wheels.py 3.13       # another version

Needs pip 25 or newer, which reads a wheel's metadata without fetching the wheel. Nothing is installed.
"""

import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

PYTHONS = ("3.11", "3.12")
EXTRAS = ("streams", "gymnasium", "studio", "submitit", "sb3", "export", "test", "dev")
"""Those that go together; `ray` and `optuna` pin other versions."""
MANYLINUX = ("manylinux2014", *(f"manylinux_2_{minor}" for minor in range(17, 36)))
"""Of glibc 2.35, Ubuntu 22.04."""
PLATFORMS = {
    "Linux x86-64": ("Linux", "x86_64", [f"{tag}_x86_64" for tag in MANYLINUX]),
    "Linux arm64": ("Linux", "aarch64", [f"{tag}_aarch64" for tag in MANYLINUX]),
    "macOS arm64": ("Darwin", "arm64", ["macosx_14_0_arm64"]),
}
"""`platform.system()`, `platform.machine()` and the tags of wheels that pip takes."""
SDISTS = ("antlr4-python3-runtime==4.9.3",)
"""Pure Python that its authors ship as source alone: a wheel is built here."""
PIP = """
import sys
from pip._internal.cli.main import main
from pip._vendor.packaging import markers
system, machine, python, *words = sys.argv[1:]
there = {"platform_system": system, "sys_platform": system.lower(), "platform_machine": machine}
here = markers.default_environment()
markers.default_environment = lambda: {**here, **there, "python_version": python, "python_full_version": python + ".0"}
sys.exit(main(words))
"""
"""pip's own command line; it would read the requirements' markers as of this machine."""


def check(platform: str, python: str, pins: list[str], sdists: str) -> str:
    """Return the error line of pip for a platform and Python version, empty if all pins have wheels."""
    system, machine, tags = PLATFORMS[platform]
    words = ["install", "--quiet", "--dry-run", "--ignore-installed", "--only-binary=:all:", "--python-version", python]
    words += ["--target", sdists, "--find-links", sdists, *(f"--platform={tag}" for tag in tags), *pins]
    done = subprocess.run(
        [sys.executable, "-c", PIP, system, machine, python, *words], capture_output=True, text=True, cwd=sdists
    )
    lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
    return "" if done.returncode == 0 else (lines or [f"pip failed: {done.stderr[-300:]}"])[-1]


def main() -> int:
    """Print a line for each platform and version; return 1 if one of them fails."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pins = project["dependencies"] + [pin for extra in EXTRAS for pin in project["optional-dependencies"][extra]]
    pins = [pin for pin in pins if not pin.startswith(project["name"])]  # extras that stand for other extras
    failed = 0
    with tempfile.TemporaryDirectory() as sdists:
        subprocess.run([sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", sdists, *SDISTS], check=True)
        for python in sys.argv[1:] or PYTHONS:
            for platform in PLATFORMS:
                error = check(platform, python, pins, sdists)
                failed += bool(error)
                print(f"Python {python}, {platform}: {error or 'all pins have wheels'}", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
