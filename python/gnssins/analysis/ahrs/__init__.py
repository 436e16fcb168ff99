"""What an attitude correction law does: poles, stability at every body rate, frequency and step response, noise.

The laws are objects of :mod:`gnssins.ahrs`. Everything is linear: small errors about level attitude where an angle is
named, any attitude and any constant body rate where it is not. The compiled estimators solve the same equations in
closed sampled form, so that the sampled figures here are those of the running law and not an approximation to them.
"""

from gnssins.analysis.ahrs.dynamics import (
    ANGLES,
    Angle,
    Model,
    Reading,
    characteristic_polynomial,
    effective_matrix,
    error_matrix,
    model,
    printed_polynomial,
)
from gnssins.analysis.ahrs.noise import NoiseGain, noise_gain
from gnssins.analysis.ahrs.response import Response, StepResponse, response, step_response
from gnssins.analysis.ahrs.simulated import (
    level_sensors,
    simulated_corner,
    simulated_noise,
    simulated_response,
    simulated_step,
)
from gnssins.analysis.ahrs.stability import Stability, euler_rate_limit, rate_grid, routh, stability

__all__ = [
    "ANGLES",
    "Angle",
    "Model",
    "NoiseGain",
    "Reading",
    "Response",
    "Stability",
    "StepResponse",
    "characteristic_polynomial",
    "effective_matrix",
    "error_matrix",
    "euler_rate_limit",
    "level_sensors",
    "model",
    "noise_gain",
    "printed_polynomial",
    "rate_grid",
    "response",
    "routh",
    "simulated_corner",
    "simulated_noise",
    "simulated_response",
    "simulated_step",
    "stability",
    "step_response",
]
