"""Compare the waveforms on disk with what the database says of them."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from service.errors import WaveformDamagedError
from service.store.waveforms import WaveformPlace, WaveformStore


@dataclass(frozen=True, slots=True)
class DamagedWindow:
    """A window that cannot be read as it was stored, and why."""

    place: WaveformPlace
    reason: str


def damaged_windows(root: Path, places: Iterable[WaveformPlace]) -> Iterator[DamagedWindow]:
    """Read windows from disk, those of a frame together, and yield the ones that are not what was stored."""
    store = WaveformStore(root)  # a new one, which remembers nothing
    for _, group in groupby(places, key=lambda place: (place.path, place.offset)):
        frame = list(group)
        try:
            store.read(frame)
        except WaveformDamagedError:
            yield from _damaged_alone(store, frame)


def _damaged_alone(store: WaveformStore, places: Iterable[WaveformPlace]) -> Iterator[DamagedWindow]:
    for place in places:
        try:
            store.read([place])
        except WaveformDamagedError as error:
            yield DamagedWindow(place, str(error))
