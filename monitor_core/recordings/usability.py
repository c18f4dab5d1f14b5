"""Say which commands take a file as it is, and what the next step with it is."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from monitor_core.recordings import recognition
from monitor_core.recordings.elements.files import stem_of
from monitor_core.recordings.raw.formats import READERS
from monitor_core.recordings.recognition import is_raw

#: What a calibration needs at the least: k1, k2 and k4 from positions, k3 from preloads, and one reading to judge them.
FEWEST_POSITIONS, FEWEST_PRELOADS, FEWEST_READINGS = 3, 2, 5
#: Commands that take a raw file together with its channel map.
WITH_MAP = ("import", "frf", "calibrate", "estimate", "explain", "identify", "replay")


@dataclass(frozen=True, slots=True)
class Use:
    """A command that takes the file, and how it is called; words in capitals are left to the user."""

    command: str
    line: str


@dataclass(frozen=True, slots=True)
class Settings:
    """At which settings the readings of a file were taken, as far as it states them."""

    n_readings: int
    positions_mm: tuple[float, ...]
    preloads_n: tuple[float, ...]
    n_with_preload: int

    @property
    def lacks_for_calibration(self) -> str:
        """What keeps a calibration from the file, in a few words; empty if nothing does."""
        if self.n_with_preload < FEWEST_READINGS:
            return f"{FEWEST_READINGS} measurements with preload_n; it has {self.n_with_preload}"
        if len(self.positions_mm) < FEWEST_POSITIONS:
            return f"{FEWEST_POSITIONS} positions; it has {len(self.positions_mm)}"
        if len(self.preloads_n) < FEWEST_PRELOADS:
            return f"{FEWEST_PRELOADS} preloads; it has {len(self.preloads_n)}"
        return ""


def uses_of_session(path: Path, settings: Settings) -> tuple[Use, ...]:
    """Return the commands that take a session; ``calibrate`` only if enough settings were set on purpose."""
    name = shlex.quote(str(path))
    uses = [Use("frf", f"preload frf {name}"), *_shared_uses(name, path, settings)]
    return (*uses, Use("replay", f"preload replay {name} --url URL --axis ID"))


def uses_of_table(path: Path, settings: Settings) -> tuple[Use, ...]:
    """Return the commands that take a modal table."""
    return tuple(_shared_uses(shlex.quote(str(path)), path, settings))


def uses_of(name: str, path: Path, made: str = ".session.h5") -> tuple[Use, ...]:
    """Return the commands that take a file of a format that needs no look at what it holds.

    ``made`` is the ending of what an import makes of a raw file.
    """
    shown = shlex.quote(str(path))
    explain = Use("explain", f"preload explain {shown} --baseline MODEL")
    if is_raw(name):
        return (Use("import", f"preload import {shown} --map MAP --out {_stem(path)}{made}"),)
    return {
        recognition.FRF_SET: (Use("identify", f"preload identify {shown} --model MODEL"), explain),
        recognition.MOTION_RECORD: (explain,),
        recognition.CALIBRATION: (
            Use("estimate", f"preload estimate DATA --calibration {shown}"),
            Use("calibrate", f"preload calibrate DATA --prior {shown}"),
        ),
        recognition.CHANNEL_MAP: (Use("import", f"preload import RAW --map {shown} --out FILE.session.h5"),),
        recognition.EFFECTS: (Use("explain", f"preload explain DATA --baseline MODEL --effects {shown}"),),
    }.get(name, ())


def uses_of_model(path: Path, *, is_motion: bool, needs_preload: bool, has_effects: bool) -> tuple[Use, ...]:
    """Return the commands that take a drive model that can be built.

    ``needs_preload``: the rigidity of its nut follows the preload; ``has_effects``: joints are identified in a model
    without any, and a session is simulated of what modes hold, which not every effect is.
    """
    shown = shlex.quote(str(path))
    if is_motion:
        return (Use("explain", f"preload explain MOTION.csv --baseline {shown}"),)
    preload = " --preload-n P" if needs_preload else ""
    modes = Use("modes", f"preload modes {shown} --position-mm X{preload}")
    explain = Use("explain", f"preload explain DATA --baseline {shown}")
    if has_effects:
        return (modes, explain)
    simulate = Use("simulate", f"preload simulate {shown} --out FILE.session.h5{preload}")
    return (modes, simulate, Use("identify", f"preload identify DATA --model {shown}"), explain)


def next_step(name: str, path: Path, uses: Sequence[Use], lacks: str = "") -> str:
    """Return the step that most users take next, as a sentence; ``lacks`` is what keeps a calibration from the file."""
    shown, stem = shlex.quote(str(path)), _stem(path)
    lines = {use.command: use.line for use in uses}
    if is_raw(name) and not uses:
        return (
            "spectra alone hold no frequency response: take the raw data (TEST_RESONANCES … OUTPUT=raw_data), with a "
            "table [excitation.sweep] in the map, as docs/how-to/resonance-tests.md shows"
        )
    if is_raw(name):
        return (
            f"preload check {shown} --write-map {stem}.toml writes a channel map to fill in; then "
            f"{lines['import'].replace('--map MAP', f'--map {stem}.toml')}"
        )
    if "calibrate" in lines and name != recognition.CALIBRATION:
        return f"{lines['calibrate']}; or, with a calibration, {lines['estimate']}"
    if name in (recognition.SESSION, recognition.MODAL_TABLE):
        first = [lines["frf"]] if "frf" in lines else []
        steps = "; ".join([*first, f"with a calibration, {lines['estimate']}"])
        return f"{steps} (a calibration of its own would need {lacks})"
    return next(iter(lines.values()), "")


def _shared_uses(name: str, path: Path, settings: Settings) -> list[Use]:
    uses = [Use("estimate", f"preload estimate {name} --calibration CALIBRATION")]
    if not settings.lacks_for_calibration:
        uses.append(Use("calibrate", f"preload calibrate {name} --out {_stem(path)}.calibration.json"))
    uses.append(Use("identify", f"preload identify {name} --model MODEL"))
    uses.append(Use("explain", f"preload explain {name} --baseline MODEL"))
    return uses


def _stem(path: Path) -> str:
    """Return what the names of results begin with: with its ending, where another raw file beside it has the name."""
    stem = stem_of(path.name)
    others = (path.with_name(f"{stem}{ending}") for ending in READERS)
    return shlex.quote(path.name if any(other.name != path.name and other.exists() for other in others) else stem)
