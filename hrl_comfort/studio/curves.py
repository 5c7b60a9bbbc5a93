"""Live curves of the last seconds: distances, speeds, comfort level and reward terms."""

from __future__ import annotations

from collections import deque

import numpy as np
import viser
import viser.uplot
from numpy.typing import NDArray

from hrl_comfort.comfort.terms import present
from hrl_comfort.studio.play import Watcher
from hrl_comfort.studio.session import Session, Step

SHOWN_S = 20.0
COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#ff7f0e", "#9467bd", "#8c564b", "#17becf", "#7f7f7f", "#bcbd22", "#e377c2")
HEIGHT_PX = 150


class Chart:
    """One chart of some series over simulated time, s."""

    def __init__(self, server: viser.ViserServer, title: str, names: tuple[str, ...]) -> None:
        self._rows: deque[tuple[float, ...]] = deque()
        series = [viser.uplot.Series(label="s")]
        series += [
            viser.uplot.Series(label=name, stroke=COLOURS[index % len(COLOURS)], width=1.5)
            for index, name in enumerate(names)
        ]
        self._handle = server.gui.add_uplot(
            data=tuple(np.zeros(1) for _ in series),
            series=tuple(series),
            title=title,
            scales={"x": viser.uplot.Scale(time=False), "y": viser.uplot.Scale(auto=True)},
            legend=viser.uplot.Legend(show=True),
            height=HEIGHT_PX,
        )

    def add(self, time_s: float, values: tuple[float, ...]) -> None:
        """Append a point to every series; those older than SHOWN_S are dropped."""
        self._rows.append((time_s, *values))
        while self._rows[0][0] < time_s - SHOWN_S:
            self._rows.popleft()

    def remove(self) -> None:
        """Take the chart off the page."""
        self._handle.remove()

    def draw(self) -> None:
        """Send the series to the page."""
        if self._rows:
            self._handle.data = tuple(np.array(column, dtype=np.float64) for column in zip(*self._rows, strict=True))


class Curves(Watcher):
    """Charts of one or more cells; a cell's values are marked with its label where there are several."""

    def __init__(self, server: viser.ViserServer, sessions: list[Session], labels: list[str]) -> None:
        self._latest: list[dict[str, NDArray[np.float64]]] = []
        self.time_s = 0.0
        """Simulated time of the latest point, s; the sessions' own times part where their episodes differ."""
        self._server, self._labels = server, labels
        self._folder = server.gui.add_folder("Curves")
        with self._folder:
            self._charts = {
                "distance": Chart(server, "distance to the person (m)", self._names("tool", "arm")),
                "speed": Chart(server, "speed (m/s)", (*self._names("tool"), "person")),
                "level": Chart(server, "comfort level", self._names("level")),
            }
        self._rewards: tuple[str, ...] = ()
        self.rejoin(sessions)

    def rejoin(self, sessions: list[Session]) -> None:
        """Follow sessions that may have other reward terms."""
        self._sessions, self._latest = sessions, [{} for _ in sessions]
        rewards = tuple(sessions[0].engine.episodes.reward_names)
        if rewards != self._rewards:
            if "reward" in self._charts:
                self._charts.pop("reward").remove()
            with self._folder:
                self._charts["reward"] = Chart(self._server, "reward of a decision", self._names(*rewards))
            self._rewards = rewards

    def _names(self, *plain: str) -> tuple[str, ...]:
        many = len(self._labels) > 1
        return tuple(f"{name} {label}" if many else name for label in self._labels for name in plain)

    def stepped(self, cell: int, session: Session, step: Step) -> None:
        """See `play.Watcher`."""
        result = step.result
        last = int(result.decision_steps) - 1
        tool = float(np.linalg.norm((result.state.tcp_pos - step.before.tcp_pos).numpy())) / step.clip.duration_s
        there = bool(present(result.state.humans_pos))
        distance = [float(result.human_distance[0, last]), float(result.state.arm_distance)]
        self._latest[cell] = {
            "distance": np.array(distance if there else [np.nan, np.nan]),
            "speed": np.array([tool]),
            "level": np.array([float(result.level)]),
            "reward": result.reward_terms[0].numpy(),
        }
        going = [index for index, each in enumerate(self._sessions) if index == cell or not each.over]
        if cell == going[-1] and all(self._latest):  # those before it have stepped
            self.time_s += step.clip.duration_s
            for name, chart in self._charts.items():
                values = np.concatenate([each[name] for each in self._latest])
                if name == "speed":
                    values = np.append(values, session.walk.speed_m_s)
                chart.add(self.time_s, tuple(float(value) for value in values))

    def draw(self) -> None:
        """Send the charts to the page."""
        for chart in self._charts.values():
            chart.draw()
