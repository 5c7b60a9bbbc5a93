"""Live streams, UDP and Lab Streaming Layer, read without blocking."""

from __future__ import annotations

import socket
import struct
import sys
import time
import warnings
from typing import Any

from hrl_comfort.config.checks import ConfigError

MAX_DATAGRAM_BYTES = 4096
MOST_DATAGRAMS = 1000
"""Datagrams of one reading, so that a flood of them cannot hold up the robot."""
POLL_S = 0.02
SO_TIMESTAMPNS = 35
"""Linux: the system notes when a datagram arrived (socket(7)); Python's `socket` does not name it."""
TIMESPEC = struct.Struct("@ll")
OPEN_S = 1.0
"""Longest time for the connection to an outlet that answers."""


def pylsl_for(key: str) -> Any:
    """Return the module pylsl; raise ConfigError, which names the `key` that needs it, without it or its library."""
    try:
        import pylsl
    except (ImportError, RuntimeError) as error:  # the second without liblsl
        raise ConfigError(f"{key} needs pylsl and liblsl: pip install 'hrl-comfort[streams]' ({error})") from error
    return pylsl


class UdpStream:
    """UDP datagrams to a port of this machine; `host` is a name or address of IPv4, or an address of IPv6.

    Raises:
      ConfigError: the port cannot be opened; `name` says which one it is.
    """

    def __init__(self, host: str, port: int, name: str) -> None:
        host = host.removeprefix("[").removesuffix("]")
        self._socket = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except (OSError, OverflowError, TypeError, ValueError) as error:  # the last two at an invalid host name
            self._socket.close()
            reason = getattr(error, "strerror", None) or error
            raise ConfigError(f"{name} cannot be opened: {reason}; choose another, or port 0 for a free one") from error
        self._socket.setblocking(False)
        if sys.platform == "linux":
            self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)

    @property
    def port(self) -> int:
        """UDP port in use."""
        return int(self._socket.getsockname()[1])

    @property
    def closed(self) -> bool:
        """Whether the port is free again."""
        return self._socket.fileno() == -1

    def close(self) -> None:
        """Free the port."""
        self._socket.close()

    def read(self) -> list[str]:
        """Return the texts since the last call, oldest first; the rest of a flood waits or is dropped by the system."""
        return [text for text, _ in self.read_stamped()]

    def read_stamped(self) -> list[tuple[str, float]]:
        """Return what `read` does, with the monotonic time at which each arrived, s."""
        arrived: list[tuple[str, float]] = []
        while len(arrived) < MOST_DATAGRAMS:
            try:
                text, notes, _, _ = self._socket.recvmsg(MAX_DATAGRAM_BYTES, socket.CMSG_SPACE(TIMESPEC.size))
            except BlockingIOError:
                break
            waited = 0.0
            for _, kind, note in notes:
                if kind == SO_TIMESTAMPNS:
                    seconds, nanoseconds = TIMESPEC.unpack(note)
                    waited = max(0.0, time.time() - seconds - 1e-9 * nanoseconds)
            arrived.append((text.decode("ascii", "replace").strip(), time.monotonic() - waited))
        return arrived


class LslStream:
    """Lab Streaming Layer stream of numbers (extra `streams`); a lost one is read again when it is back.

    Args:
      name: of the stream.
      channels: allowed numbers of channels; a stream of other channels, or of text, is not read.
      wait_s: time within which it must appear.
      key: configuration key, for messages.

    Raises:
      ConfigError: pylsl is missing, or no such stream appears.
    """

    def __init__(self, name: str, channels: tuple[int, ...], wait_s: float, key: str) -> None:
        self._lsl, self._name, self._channels, self._key = pylsl_for(key), name, channels, key
        self._inlet: Any = None
        self._resolver: Any = None
        self._unfit = ""
        self._search()
        deadline = time.monotonic() + wait_s
        while not self._connected():
            if time.monotonic() > deadline:
                remedy = f"within {wait_s:g} s; start its outlet first{self._unfit}"
                raise ConfigError(f"{key}: no such Lab Streaming Layer stream {remedy}")
            time.sleep(POLL_S)

    def close(self) -> None:
        """Stop listening."""
        self._inlet = self._resolver = None

    def read(self) -> list[list[float]]:
        """Return the samples since the last call, oldest first; of more than a second, the newest second."""
        return [sample for sample, _ in self.read_stamped()]

    def read_stamped(self) -> list[tuple[list[float], float]]:
        """Return what `read` does, with the monotonic time at which each was sent, s."""
        try:
            if self._inlet is not None or self._connected():
                samples, stamps = self._inlet.pull_chunk(timeout=0.0)
                shift = time.monotonic() - self._lsl.local_clock()
                return [(sample, stamp + shift) for sample, stamp in zip(samples, stamps, strict=True)]
        except RuntimeError:  # LostError
            warnings.warn(f"{self._key}: the stream is lost; it is read again when it is back", stacklevel=2)
            self._search()
        return []

    def _search(self) -> None:
        self._inlet, self._resolver = None, self._lsl.ContinuousResolver(prop="name", value=self._name)

    def _connected(self) -> bool:
        """Connect to the first stream found that fits; return whether there is one."""
        for found in self._resolver.results():
            channels, text = found.channel_count(), found.channel_format() == self._lsl.cf_string
            if text or channels not in self._channels:
                wanted = " or ".join(map(str, self._channels))
                unfit = f"; one has {channels} channel(s) of {'text' if text else 'numbers'}, not {wanted} of numbers"
                if self._unfit != unfit:
                    self._unfit = unfit
                    warnings.warn(f"{self._key}{unfit}: not used", stacklevel=3)
                continue
            synced = self._lsl.proc_clocksync
            inlet = self._lsl.StreamInlet(found, max_buflen=1, recover=False, processing_flags=synced)
            try:
                inlet.open_stream(timeout=OPEN_S)
            except RuntimeError:  # it is gone again
                continue
            self._inlet, self._resolver = inlet, None
            return True
        return False
