"""Forms: an input for every key of a section of the configuration, with its meaning and what it allows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import is_dataclass
from typing import Any, get_args

from hrl_comfort.composition.keys import Key, choices_of, keys_of
from hrl_comfort.config import ConfigError
from hrl_comfort.config.overrides import groups, override
from hrl_comfort.studio.tune.draft import Draft

KEPT = "as it is"
"""Choice of a group that changes nothing."""


class Form:
    """Inputs of some sections of a draft, a folder each, with the choices of its Hydra group first.

    Args:
      gui: of the page.
      draft: what they change.
      sections: names of the sections.
      changed: called after each change with an error, or None.
    """

    def __init__(
        self, gui: Any, draft: Draft, sections: Iterable[str], changed: Callable[[ConfigError | None], None]
    ) -> None:
        self._draft, self._changed = draft, changed
        self._inputs: dict[str, Any] = {}
        for section in sections:
            with gui.add_folder(section, expand_by_default=False):
                if choices := groups(draft.root).get(section):
                    chosen = gui.add_dropdown(section, (KEPT, *choices), initial_value=KEPT)
                    chosen.on_update(lambda event, section=section: self._choose(event, section))
                for key in keys_of(draft.root):
                    if key.section == section and not key.of_entry and not self._of_parts(key):
                        self._inputs[key.name] = self._add(gui, key)

    def _of_parts(self, key: Key) -> bool:
        """Return whether a key has keys of its own, which an overlay states better than a form."""
        parts = [each for each in get_args(key.hint) if isinstance(each, type)]
        return isinstance(self._draft.value(key.name), dict) or any(map(is_dataclass, parts))

    def _add(self, gui: Any, key: Key) -> Any:
        value, label = self._draft.value(key.name), key.name.partition(".")[2]
        hint = f"{key.meaning} {key.allowed}".replace("`", "").strip()
        if isinstance(value, bool):
            made = gui.add_checkbox(label, value, hint=hint)
        elif names := choices_of(key.hint):
            made = gui.add_dropdown(label, names, initial_value=str(value), hint=hint)
        else:
            made = gui.add_text(label, written(value), hint=hint)
        made.on_update(lambda event: self._edit(event, key.name))
        return made

    def _edit(self, event: Any, key: str) -> None:
        """Take over what an input shows by now; the callbacks of quick edits may overtake one another."""
        if event.client is not None:
            value = event.target.value
            self._set(key, written(value) if isinstance(value, bool) else str(value))

    def _choose(self, event: Any, section: str) -> None:
        if event.client is not None and event.target.value != KEPT:
            self._set(section, event.target.value)
            for key, each in self._inputs.items():
                if key.startswith(f"{section}."):
                    value = self._draft.value(key)
                    each.value = value if isinstance(value, bool) else written(value)

    def _set(self, key: str, text: str) -> None:
        if key in self._inputs and text == written(self._draft.value(key)):
            return
        try:
            self._draft.set(key, text)
        except ConfigError as error:
            self._changed(error)
        else:
            self._changed(None)


def written(value: object) -> str:
    """Return a value as it is written on the command line, a plain text without quotes."""
    return value if isinstance(value, str) else override("", value).removeprefix("=")
