"""User configuration: one TOML file in the units of data sheets, checked in full, converted to SI here only.

:class:`Config` is the file; one class per table stands beside it. :func:`render_reference` writes the
commented list of all keys.
"""

from .aids import BaroConfig, HeadingConfig
from .axes import axes_matrix, proper_letters
from .filter import BLOCK_SIZES, BLOCK_UNITS, BlockConfig, FilterConfig
from .gnss import GnssConfig, TruthConfig
from .imu import AccelConfig, GyroConfig, ImuConfig
from .presets import load_preset, preset_names
from .reference import render_reference
from .root import Config, parse_toml
from .start import GeoPoint, InitialConfig, RunConfig

__all__ = [
    "BLOCK_SIZES",
    "BLOCK_UNITS",
    "AccelConfig",
    "BaroConfig",
    "BlockConfig",
    "Config",
    "FilterConfig",
    "GeoPoint",
    "GnssConfig",
    "GyroConfig",
    "HeadingConfig",
    "ImuConfig",
    "InitialConfig",
    "RunConfig",
    "TruthConfig",
    "axes_matrix",
    "load_preset",
    "parse_toml",
    "preset_names",
    "proper_letters",
    "render_reference",
]
