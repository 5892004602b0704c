"""From a tracked sweep to a volume, live or from files; calibration; trust."""

from . import phantoms
from .calibration import Calibration, PointTarget, calibrate_point_target, read_calibration, write_calibration
from .files import read_sweep
from .measuring import MeasuredDistance, MeasuredVolume, find_error_length, measure_distance, measure_volume
from .n_wires import NWireCalibration, calibrate_n_wires, validate_n_wires
from .plus.reconstruct import reconstruct_plus
from .reconstruct import reconstruct
from .reconstructor import Reconstructor
from .registration import Registration, RegistrationError, join_sweeps, register_and_join, register_sweeps
from .stylus import Pivot, calibrate_stylus, register_landmarks, write_stylus
from .sweep import Sweep
from .sweep_writing import write_sweep

__all__ = [
    "Calibration",
    "MeasuredDistance",
    "MeasuredVolume",
    "NWireCalibration",
    "Pivot",
    "PointTarget",
    "Reconstructor",
    "Registration",
    "RegistrationError",
    "Sweep",
    "calibrate_n_wires",
    "calibrate_point_target",
    "calibrate_stylus",
    "find_error_length",
    "join_sweeps",
    "measure_distance",
    "measure_volume",
    "phantoms",
    "read_calibration",
    "read_sweep",
    "reconstruct",
    "reconstruct_plus",
    "register_and_join",
    "register_landmarks",
    "register_sweeps",
    "validate_n_wires",
    "write_calibration",
    "write_stylus",
    "write_sweep",
]
