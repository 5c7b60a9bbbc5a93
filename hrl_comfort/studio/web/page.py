"""`hrl-comfort studio export=FILE.html`: one page that plays policies in any browser, without a server."""

from __future__ import annotations

import base64
import gzip
import html
import json
import re
from importlib.resources import files
from pathlib import Path

from rich.console import Console

from hrl_comfort.config import ConfigError, StudioConfig
from hrl_comfort.files.atomic import write_atomically
from hrl_comfort.files.output import output_file
from hrl_comfort.scene.looks.arms import ARMS_LICENCE
from hrl_comfort.studio.web.content import content

BUNDLE = ("page.js", "mujoco.wasm", "licenses.txt")
"""Files that `make page` writes to `dist/`."""


def export_page(config: StudioConfig) -> Path:
    """Write the page `config.export` and return its path.

    Raises:
      ConfigError: the page's program is not built, the file is not this program's, or a policy does not fit.
    """
    output, here = Path(config.export or ""), files("hrl_comfort.studio.web")
    program, wasm, licences = bundle = [here / "dist" / name for name in BUNDLE]
    if not all(part.is_file() for part in bundle):
        raise ConfigError(f"export={config.export!r}: the page's program is not built; run make page (it needs Node)")
    with output_file(output):
        made = content(config)
        parts = {
            "card": (files("hrl_comfort.studio") / "card.css").read_text(encoding="utf-8"),
            "title": html.escape(made["title"]),
            "licences": html.escape(
                f"{licences.read_text(encoding='utf-8')}\n{'-' * 80}\n\n{ARMS_LICENCE.read_text(encoding='utf-8')}"
            ),
            "wasm": _packed(wasm.read_bytes()),
            "content": _packed(json.dumps(made, separators=(",", ":"), allow_nan=False).encode()),
            "program": program.read_text(encoding="utf-8").replace("</script", "<\\/script"),
        }
        template = (here / "page.html").read_text(encoding="utf-8")
        page = re.sub(r"{{(\w+)}}", lambda found: parts[found[1]], template)  # at once: a title may have braces too
        write_atomically(output, lambda file: file.write(page.encode()))
    Console().print(f"{output}: {len(page) / 1e6:.1f} MB, opens in any browser", soft_wrap=True)
    return output


def _packed(data: bytes) -> str:
    """Return data gzipped, in base64."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode()
