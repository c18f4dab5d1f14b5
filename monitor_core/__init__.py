"""Measure ball-screw preload, identify joints, and explain where model and measurement differ: the library's face.

>>> import monitor_core as mc
>>> from monitor_core import recordings

``mc.calibrate``, ``mc.identify``, ``mc.explain`` and the others are pure functions on frozen records;
``recordings`` reads and writes files. No clock, environment, log, web or database. The names below
are imported from their modules when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from monitor_core.change import attribute_change as attribute_change
    from monitor_core.discrepancy import (
        ExplainOptions as ExplainOptions,
        Explanation as Explanation,
        Outcome as Outcome,
        explain as explain,
    )
    from monitor_core.effects import Effect as Effect, EffectParameter as EffectParameter
    from monitor_core.errors import MonitorCoreError as MonitorCoreError
    from monitor_core.fitting.axis import AxisDescription as AxisDescription
    from monitor_core.fitting.observations import (
        FrequencyResponseObservation as FrequencyResponseObservation,
        ModalObservation as ModalObservation,
    )
    from monitor_core.identification import (
        IdentifiedJoints as IdentifiedJoints,
        IdentifyOptions as IdentifyOptions,
        identify as identify,
    )
    from monitor_core.measured_responses import responses_of_session as responses_of_session
    from monitor_core.modal import measure_mode as measure_mode
    from monitor_core.models.families import build_model as build_model
    from monitor_core.models.generator import simulate_session as simulate_session
    from monitor_core.models.protocol import (
        DriveConditions as DriveConditions,
        ExcitationPoint as ExcitationPoint,
        MotorEnd as MotorEnd,
        ResponsePoint as ResponsePoint,
    )
    from monitor_core.pipeline import AxisSettings as AxisSettings
    from monitor_core.preload import (
        Calibration as Calibration,
        ModalReading as ModalReading,
        PreloadEstimate as PreloadEstimate,
        calibrate as calibrate,
        estimate_preload as estimate_preload,
    )
    from monitor_core.recording import (
        Conditions as Conditions,
        Rejection as Rejection,
        Session as Session,
        Window as Window,
    )
    from monitor_core.response import FrequencyResponse as FrequencyResponse
    from monitor_core.session import (
        Trend as Trend,
        calibrate_session as calibrate_session,
        judge_session as judge_session,
    )
    from monitor_core.uncertainty import Estimate as Estimate, Interval as Interval

#: Where each name of the face lives: imported when it is first used, so that a command pays for what it needs alone.
_HOMES = {
    "monitor_core.change": ("attribute_change",),
    "monitor_core.discrepancy": ("ExplainOptions", "Explanation", "Outcome", "explain"),
    "monitor_core.effects": ("Effect", "EffectParameter"),
    "monitor_core.errors": ("MonitorCoreError",),
    "monitor_core.fitting.axis": ("AxisDescription",),
    "monitor_core.fitting.observations": ("FrequencyResponseObservation", "ModalObservation"),
    "monitor_core.identification": ("IdentifiedJoints", "IdentifyOptions", "identify"),
    "monitor_core.measured_responses": ("responses_of_session",),
    "monitor_core.modal": ("measure_mode",),
    "monitor_core.models.families": ("build_model",),
    "monitor_core.models.generator": ("simulate_session",),
    "monitor_core.models.protocol": ("DriveConditions", "ExcitationPoint", "MotorEnd", "ResponsePoint"),
    "monitor_core.pipeline": ("AxisSettings",),
    "monitor_core.preload": ("Calibration", "ModalReading", "PreloadEstimate", "calibrate", "estimate_preload"),
    "monitor_core.recording": ("Conditions", "Rejection", "Session", "Window"),
    "monitor_core.response": ("FrequencyResponse",),
    "monitor_core.session": ("Trend", "calibrate_session", "judge_session"),
    "monitor_core.uncertainty": ("Estimate", "Interval"),
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names}
__all__ = sorted(_HOME_OF)  # noqa: PLE0605  # what `help` and an editor show


def __getattr__(name: str) -> object:
    if name == "__version__":
        try:
            return import_module("importlib.metadata").version("preload-monitor")
        except ImportError as error:
            raise AttributeError("preload-monitor is not installed: it has no version") from error
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME_OF})
