"""Measure natural frequencies from responses, with their covariance (ISO 13374: DM, data manipulation)."""

from monitor_core.modal.averaging import Candidate, candidate_peaks
from monitor_core.modal.excitation_level import COMPARABLE_FACTOR, excitation_remark, session_remarks
from monitor_core.modal.gates import ModeGate
from monitor_core.modal.measure import ModalMeasurement, measure_mode, measure_modes
from monitor_core.modal.phase import PhaseReference, calibrate_phase
from monitor_core.modal.refine import ModeFit, fit_modes

__all__ = [
    "COMPARABLE_FACTOR",
    "Candidate",
    "ModalMeasurement",
    "ModeFit",
    "ModeGate",
    "PhaseReference",
    "calibrate_phase",
    "candidate_peaks",
    "excitation_remark",
    "fit_modes",
    "measure_mode",
    "measure_modes",
    "session_remarks",
]
