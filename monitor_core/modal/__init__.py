"""Measure natural frequencies from responses, with their covariance (ISO 13374: DM, data manipulation)."""

from monitor_core.modal.averaging import Candidate as Candidate, candidate_peaks as candidate_peaks
from monitor_core.modal.channels import PhaseReference as PhaseReference, calibrate_phase as calibrate_phase
from monitor_core.modal.gates import GateReading as GateReading, ModeGate as ModeGate, gate_readings as gate_readings
from monitor_core.modal.measure import (
    COMPARABLE_FACTOR as COMPARABLE_FACTOR,
    ModalMeasurement as ModalMeasurement,
    ModeReadings as ModeReadings,
    averaged_response as averaged_response,
    excitation_remark as excitation_remark,
    measure_mode as measure_mode,
    measure_modes as measure_modes,
    read_gates as read_gates,
    session_remarks as session_remarks,
)
from monitor_core.modal.refine import ModeFit as ModeFit, fit_modes as fit_modes
