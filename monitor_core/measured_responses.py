"""Turn judged measurements into the frequency responses that an identification or an explanation takes."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor_core.errors import NotIdentifiableError
from monitor_core.fitting.observations import FrequencyResponseObservation
from monitor_core.modal import ModalMeasurement
from monitor_core.models.generator import EXCITED
from monitor_core.models.protocol import DriveConditions, ExcitationPoint, ResponsePoint
from monitor_core.pipeline import AxisSettings, measure_response
from monitor_core.recording import Conditions, ExcitationQuantity, Rejection, ResponseQuantity, Window
from monitor_core.session import RecordedMeasurements, gate_session
from monitor_core.spectral import line_spread
from monitor_core.spectral.coherence import random_error, significance_level
from monitor_core.spectral.spectra import Taper

#: Responses that are compared with those of a model, as accelerations.
_OF_TABLE = (ResponseQuantity.ACCELERATION, ResponseQuantity.VELOCITY, ResponseQuantity.DISPLACEMENT)
#: Every which line is independent of the others: a Hann window correlates neighbours by 2/3 and the next by 1/6.
STRIDE: dict[Taper, int] = {"hann": 3, "rectangular": 1}


def measured_responses(
    measurements: Iterable[ModalMeasurement], *, usual_temperature: float | None = None
) -> tuple[FrequencyResponseObservation, ...]:
    r"""Return the averaged responses of measurements with the noise of their lines.

    The standard deviation of real and of imaginary part of H1 is :math:`|H| \sqrt{(1 - \gamma^2)/(2 n \gamma^2)}`
    (Bendat and Piersol, Random Data, Eq. 9.90). Lines whose coherence could be chance are left out, and so are those
    that a taper ties to their neighbours: the rest are independent.

    The measurements are those that the product's own road judges. A measured torque acts at the end of the screw, a
    drive's torque on the rotor. Stated temperatures are counted from the usual one [°C]; without it they are not looked
    at. ``NotIdentifiableError`` if there is no measurement.
    """
    return _some(_response(modal, usual_temperature) for modal in measurements)


@dataclass(frozen=True, slots=True, eq=False)
class SessionResponses:
    """Responses of a session."""

    observations: tuple[FrequencyResponseObservation, ...]
    sentences: tuple[str, ...] = ()  # what was settled on the way, for people


def responses_of_windows(
    measured: Iterable[tuple[ModalMeasurement | Rejection, Sequence[Window]]],
) -> SessionResponses:
    """Return averaged responses, as :func:`measured_responses` does, with what their windows show of a response.

    Where all of them state their temperature, it is counted from the median, to the kelvin: told closer, no two
    measurements would be of one temperature. Of a rectangular taper, which is chosen where it leaves the higher
    coherence, mostly of impacts that ring out within their window, nothing is said: what rings on beyond the end is not
    corrected. Each measurement, or why it cannot be judged, comes with all the windows that it was judged by.
    ``NotIdentifiableError`` if there is no response.
    """
    responses, refusals = [], []
    for modal, windows in measured:
        if isinstance(modal, Rejection):
            refusals.append(modal)
        else:
            responses.append((_with_spread(modal, windows), modal.conditions.temperature))
    observations = _some(response for response, _ in responses)
    left_out = _left_out(refusals, len(refusals) + len(responses))
    temperatures = [temperature for response, temperature in responses if response is not None]
    stated = [temperature for temperature in temperatures if temperature is not None]
    if len(stated) < len(temperatures):
        none = f"Temperatures are not compared: {len(temperatures) - len(stated)} of {len(temperatures)} state none."
        return SessionResponses(observations, (*left_out, none) if stated else left_out)
    usual = float(np.median(stated))
    counted = tuple(
        replace(lines, conditions=replace(lines.conditions, temperature_deviation=float(round(temperature - usual))))
        for lines, temperature in zip(observations, stated, strict=True)
    )
    varied = any(lines.conditions.temperature_deviation for lines in counted)
    sentence = f"Temperatures are counted from {usual:.4g} °C, their median, to the kelvin."
    return SessionResponses(counted, (*left_out, sentence) if varied else left_out)


def responses_of_session(session: RecordedMeasurements, settings: AxisSettings) -> SessionResponses:
    """Return the averaged responses of the measurements of a session that can be judged, on all their lines.

    All lines of a measurement count, wherever its mode is looked for. ``NotIdentifiableError`` if there is no response.

    Examples
    --------
    The largest line is at the mode of the plant that recorded it, between 178 and 198 Hz:

    >>> from pathlib import Path
    >>> import monitor_core as mc
    >>> from monitor_core import recordings
    >>> with recordings.open_session(Path("replay_data/healthy-month.session.h5")) as session:
    ...     first = mc.Session("mill", session.windows_of("healthy-000"))
    >>> [seen] = mc.responses_of_session(first, mc.AxisSettings(search_band=(140.0, 230.0))).observations
    >>> float(seen.frequency[abs(seen.response).argmax()])
    188.0
    """
    return responses_of_windows(
        (measure_response(gated.accepted, settings) if gated.accepted else gated.rejection, gated.accepted)
        for gated in gate_session(session, settings)
    )


def _left_out(refusals: Sequence[Rejection], n_measured: int) -> tuple[str, ...]:
    if not refusals:
        return ()
    reasons = ", ".join(sorted({str(refusal.reason) for refusal in refusals}))
    are = "is" if len(refusals) == 1 else "are"
    return (f"{len(refusals)} of {n_measured} measurements {are} left out: {reasons}.",)


def _with_spread(modal: ModalMeasurement, windows: Sequence[Window]) -> FrequencyResponseObservation | None:
    response = _response(modal, None)
    if response is None or modal.taper != "hann" or windows[0].reference is not None:
        return response
    refused = {index for index, _ in modal.refused_windows}
    kept = [window for index, window in enumerate(windows) if index not in refused]
    excitation = np.array([window.excitation for window in kept], dtype=np.float64)
    return replace(response, spread=line_spread(excitation, kept[0].sample_rate, response.frequency))


def _some(responses: Iterable[FrequencyResponseObservation | None]) -> tuple[FrequencyResponseObservation, ...]:
    observations = tuple(response for response in responses if response is not None)
    if not observations:
        raise NotIdentifiableError(
            "expected measurements that can be judged, of torque or force and motion of the table, and lines whose "
            "coherence is no chance; got none of both"
        )
    return observations


def _response(modal: ModalMeasurement, usual_temperature: float | None) -> FrequencyResponseObservation | None:
    frf = modal.frequency_response
    if frf.coherence is None or modal.excitation_quantity.is_relative or modal.response_quantity not in _OF_TABLE:
        return None
    coherence = np.asarray(frf.coherence)
    seen = np.flatnonzero((coherence > significance_level(frf.n_averages)) & (coherence < 1.0))[:: STRIDE[modal.taper]]
    if seen.size == 0:
        return None
    error = random_error(coherence[seen], frf.n_averages)
    return FrequencyResponseObservation(
        _conditions(modal.conditions, usual_temperature),
        frf.frequency[seen],
        frf.response[seen],
        np.abs(frf.response[seen]) * error,
        _excitation_point(modal),
        ResponsePoint.ACCELERATION_AT_TABLE,
        placed=False,
    )


def _conditions(conditions: Conditions, usual_temperature: float | None) -> DriveConditions:
    # The mean of 15 windows at 600 mm is 599.9999999999999 mm: to the micrometre, a place is one and can be named.
    position = round(conditions.position, 6)
    deviation = 0.0
    if usual_temperature is not None and conditions.temperature is not None:
        deviation = conditions.temperature - usual_temperature
    return DriveConditions(position, conditions.preload, conditions.payload_mass or 0.0, deviation)


def _excitation_point(modal: ModalMeasurement) -> ExcitationPoint:
    if modal.excitation_quantity is ExcitationQuantity.FORCE:
        return ExcitationPoint.FORCE_AT_TABLE
    # a commanded torque is one of the motor, too
    return EXCITED.get(modal.excitation_source, ExcitationPoint.TORQUE_AT_MOTOR)
