"""What goes wrong between the machine and the file."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.plant.recorder import RecordedWindow

Windows = list[RecordedWindow]
Trouble = Callable[[Windows], Windows]


def none(windows: Windows) -> Windows:
    """Leave the windows as the machine gave them."""
    return windows


def first(count: int, spoil: Callable[[RecordedWindow], RecordedWindow]) -> Trouble:
    """Spoil the first windows of a measurement."""
    return lambda windows: [spoil(w) if i < count else w for i, w in enumerate(windows)]


def every(spoil: Callable[[RecordedWindow], RecordedWindow]) -> Trouble:
    """Spoil all windows of a measurement."""
    return lambda windows: [spoil(w) for w in windows]


def keep(count: int) -> Trouble:
    """Stop the measurement after some windows."""
    return lambda windows: windows[:count]


def drop_out(window: RecordedWindow) -> RecordedWindow:
    """Lose a stretch of the acceleration: not a number."""
    response = window.response.copy()
    response[400:440] = np.nan
    return replace(window, response=response)


def clip(window: RecordedWindow) -> RecordedWindow:
    """Record with an amplifier set eight times too high: the converter is full at ±8 m/s²."""
    return replace(window, response=np.clip(window.response, np.float32(-8.0), np.float32(8.0)))


def unplug(window: RecordedWindow) -> RecordedWindow:
    """Record the acceleration from an open cable."""
    return replace(window, response=np.zeros_like(window.response))


def freeze(window: RecordedWindow) -> RecordedWindow:
    """Repeat the last torque from the middle of the window on."""
    excitation = window.excitation.copy()
    excitation[excitation.size // 2 :] = excitation[excitation.size // 2]
    return replace(window, excitation=excitation)


def cut(n_samples: int) -> Callable[[RecordedWindow], RecordedWindow]:
    """End the record after some samples."""

    def spoil(window: RecordedWindow) -> RecordedWindow:
        return replace(
            window,
            excitation=window.excitation[:n_samples],
            response=window.response[:n_samples],
            position=window.position[:n_samples],
        )

    return spoil


def turn_round(window: RecordedWindow) -> RecordedWindow:
    """Mount the accelerometer the wrong way round."""
    return replace(window, response=-window.response)


def lose_synchrony(windows: Windows) -> Windows:
    """Pair each torque with the acceleration of the next window."""
    responses = [w.response for w in windows]
    return [replace(w, response=r) for w, r in zip(windows, responses[1:] + responses[:1], strict=True)]
