"""Measure natural frequencies from responses, with their covariance (ISO 13374: DM, data manipulation)."""

from monitor_core.modal.averaging import Candidate, candidate_peaks
from monitor_core.modal.channels import PhaseReference, calibrate_phase
from monitor_core.modal.gates import GateReading, ModeGate, gate_readings
from monitor_core.modal.measure import (
    COMPARABLE_FACTOR,
    ModalMeasurement,
    ModeReadings,
    averaged_response,
    excitation_remark,
    measure_mode,
    measure_modes,
    read_gates,
    session_remarks,
)
from monitor_core.modal.refine import ModeFit, fit_modes

__all__ = [
    "COMPARABLE_FACTOR",
    "Candidate",
    "GateReading",
    "ModalMeasurement",
    "ModeFit",
    "ModeGate",
    "ModeReadings",
    "PhaseReference",
    "averaged_response",
    "calibrate_phase",
    "candidate_peaks",
    "excitation_remark",
    "fit_modes",
    "gate_readings",
    "measure_mode",
    "measure_modes",
    "read_gates",
    "session_remarks",
]
