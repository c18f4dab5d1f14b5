"""Joints of an axis from its stored measurements or from posted peaks: the work of a job of kind ``identification``."""

import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from threadpoolctl import threadpool_limits

from monitor_core.recording import ExcitationSource
from monitor_core.recordings.elements.units import metres
from monitor_core.recordings.model_file import parse_model
from monitor_core.uncertainty import Estimate
from service.documents.measurement import finite_or_null
from service.jobs import JobHandle
from service.operations.axis_measurements import measured_of_axis, selected_measurements
from service.operations.identification.joint_identification import (
    OBJECTIVES,
    IdentificationRequest,
    identify_joints,
    require_identifiable,
)
from service.operations.identification.predicted_calibration import PredictionRequest
from service.store.axes import get_axis
from service.store.database import Database
from service.store.waveforms import WaveformStore

#: How often the progress of a job is stored.
REPORT_EVERY_S = 0.5


class Identifications:
    """Identifies joints in the background."""

    def __init__(self, database: Database, waveforms: WaveformStore) -> None:
        self._database = database
        self._waveforms = waveforms

    def require(self, axis_id: str, arguments: dict[str, Any]) -> None:
        """Refuse what cannot be identified before a job is made of it, as far as that shows without measuring.

        Raises
        ------
        MonitorCoreError, ServiceError
            With the reason in one sentence.
        """
        with self._database.read() as session:
            get_axis(session, axis_id)
        if arguments["peaks"] is not None:
            require_identifiable(self._request(axis_id, arguments))
        else:
            parse_model(arguments["model"], "model")
            selected_measurements(self._database, axis_id, arguments)

    def run(self, job: JobHandle) -> None:
        """Identify the joints; begun anew if it was interrupted."""
        request = self._request(job.axis_id, job.arguments)
        reported, steps = time.monotonic(), 1

        def progress(done: int, total: int) -> None:
            nonlocal reported, steps
            steps = total
            if time.monotonic() - reported >= REPORT_EVERY_S:
                reported = time.monotonic()
                job.report(done, total, {})

        # In a process of its own: searching would keep the interpreter from everything that comes in meanwhile.
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, spawn, initializer=threadpool_limits, initargs=(1,)) as pool:
            document = identify_joints(request, map_function=pool.map, progress=progress)
        job.report(steps, steps, finite_or_null(document))

    def _request(self, axis_id: str, arguments: dict[str, Any]) -> IdentificationRequest:
        measured = measured_of_axis(self._database, self._waveforms, axis_id, arguments)
        return IdentificationRequest(
            model=parse_model(arguments["model"], "model"),
            measured=measured.observations,
            hold_out=tuple(metres(one) for one in arguments["hold_out_mm"]),
            limits={name: (low, high) for name, (low, high) in arguments["limits"].items()},
            weighting=OBJECTIVES[arguments["objective"]],
            seed=arguments["seed"],
            prediction=_prediction(arguments["prediction"]),
            accelerometer=arguments.get("accelerometer"),  # a job of an older version has none
            taken_as=measured.sentences,
        )


def _prediction(asked: dict[str, Any] | None) -> PredictionRequest | None:
    if asked is None:
        return None
    low, high = asked["mode_hz"]
    preload = Estimate(asked["preload_n"], asked["preload_standard_uncertainty_n"])
    return PredictionRequest((low, high), preload, asked["scatter_hz"], ExcitationSource(asked["excitation_source"]))
