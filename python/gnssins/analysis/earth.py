"""Simplified radii and gravity of publications against the closed forms of the engine.

The simplified forms are those of a diploma thesis (National Aviation University, Kyiv, 2011) on a strapdown system in
the geographic frame. Each stands here in the form that follows from the ellipsoid, and, where print differs, also as
printed (names that end in ``printed``), so that one sees what the slip does. With x = h/a, s = sin^2(latitude) and
q = u^2 a/g_e (centrifugal over gravitational acceleration).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gnssins import _core
from gnssins.analysis import text
from gnssins.errors import ConfigError

__all__ = [
    "EARTH_FORMS",
    "EarthVariants",
    "VariantError",
    "earth_variants",
    "gravity_down",
    "gravity_north",
    "inverse_radii",
]

Array = NDArray[np.float64]

#: Rate of the Earth (rad/s) and its gravitational constant (m^3/s^2) as the publication uses it.
EARTH_RATE_RAD_S: Final = 7.292115e-5
GM_M3_S2: Final = 398600.44e9

#: Gravity at the equator, m/s^2, of the series.
EQUATOR_M_S2: Final = 9.78033

#: 1 mGal in m/s^2.
MGAL: Final = 1e-5

#: Ground speed at which an error of a radius is told as the drift of a gyro, m/s.
CRUISE_M_S: Final = 230.0


@dataclass(frozen=True)
class _Point:
    """What the formulas are written in: axis (m), eccentricity squared, h/a, sin and cos of the latitude."""

    a: float
    e2: float
    x: Array
    sin: Array
    cos: Array

    @property
    def s(self) -> Array:
        return self.sin**2

    @property
    def q(self) -> float:
        return EARTH_RATE_RAD_S**2 * self.a / EQUATOR_M_S2


_Formula = Callable[[_Point], Array]


def _meridian_long(p: _Point) -> Array:
    e2, x, s = p.e2, p.x, p.s
    second = -2.0 * e2 * x + 3.0 * e2 * x * s + x**2 + e2**2 * (1.0 - 1.5 * s + 0.375 * s**2)
    return (1.0 + e2 - x - 1.5 * e2 * s + second) / p.a


def _prime_long(p: _Point) -> Array:
    e2, x, s = p.e2, p.x, p.s
    return (1.0 - x - 0.5 * e2 * s + x**2 + e2 * x * s - e2**2 * s**2 / 8.0) / p.a


def _gravity_long(p: _Point, constant: float = -3.0 / 28.0) -> Array:
    e2, q, x, s = p.e2, p.q, p.x, p.s
    sin2 = 4.0 * s * (1.0 - s)  # sin^2 of twice the latitude
    along = (5.0 * q - e2) / 2.0 - e2**2 / 8.0 + constant * q * e2 + (3.0 * e2 - 5.0 * q) * x
    tail = -0.5 * q * e2 * s**2 + e2 / 16.0 * (e2 / 2.0 - 7.0 * q) * sin2
    return EQUATOR_M_S2 * (1.0 - 2.0 * x - (e2 + 2.0 * q - 3.0 * x) * x + along * s + tail)


def _gravity_regrouped(p: _Point, surface: float = 2.5, height: tuple[float, float] = (-2.0, -5.0)) -> Array:
    e2, q, x, s = p.e2, p.q, p.x, p.s
    sin2 = 4.0 * s * (1.0 - s)
    first = -0.5 * e2 * s + surface * q * s + e2**2 * (-s / 8.0 + sin2 / 32.0)
    second = e2 * q * (-17.0 * s / 28.0 - 5.0 * sin2 / 16.0)
    free_air = x * e2 * (3.0 * s - 1.0) + x * q * (height[0] + height[1] * s) - 2.0 * x + 3.0 * x**2
    return EQUATOR_M_S2 * (1.0 + first + second + free_air)


def _gravity_short(p: _Point, e: float | None = None) -> Array:
    shape = p.e2 if e is None else e
    return EQUATOR_M_S2 * (1.0 + 0.0053024 * p.s) * (1.0 - 2.0 * p.x * (1.0 - shape * p.s))


def _gravity_mu(p: _Point) -> Array:
    return GM_M3_S2 / p.a**2 * (1.0 - 2.0 * p.x + 0.75 * p.e2 * p.s)


_MERIDIAN: Final[dict[str, _Formula]] = {
    "short": lambda p: (1.0 + p.e2 - p.x - 1.5 * p.e2 * p.s) / p.a,
    "short, printed": lambda p: (1.0 - p.e2 - p.x - 1.5 * p.e2 * p.s) / p.a,
    "long": _meridian_long,
}
_PRIME: Final[dict[str, _Formula]] = {
    "short": lambda p: (1.0 - p.x - 0.5 * p.e2 * p.s) / p.a,
    "long": _prime_long,
}
_DOWN: Final[dict[str, _Formula]] = {
    "short": _gravity_short,
    "short, printed": lambda p: _gravity_short(p, math.sqrt(p.e2)),
    "long": _gravity_long,
    "long, printed": lambda p: _gravity_long(p, 17.0 / 18.0),
    "regrouped": _gravity_regrouped,
    "regrouped, printed": lambda p: _gravity_regrouped(p, 1.5, (-1.0, -6.0)),
    "mu/a^2": _gravity_mu,
}
_NORTH: Final[dict[str, _Formula]] = {
    "series": lambda p: EQUATOR_M_S2 * p.x * (p.e2 - 5.0 * p.q) * p.sin * p.cos,
    "none": lambda p: np.zeros_like(p.x),
}

#: Names of the simplified forms by quantity; the closed form of the engine is ``"closed"`` everywhere.
EARTH_FORMS: Final = {
    "1/(R_M+h)": tuple(_MERIDIAN),
    "1/(R_P+h)": tuple(_PRIME),
    "gravity down": tuple(_DOWN),
    "gravity north": tuple(_NORTH),
}


@dataclass(frozen=True)
class VariantError:
    """Largest error of one form, and where.

    ``error`` is relative for radii and in m/s^2 for gravity, form minus closed form.
    """

    quantity: str
    form: str
    error: float
    lat_deg: float
    height_m: float

    @property
    def shown(self) -> str:
        """The error in the unit of its kind: relative, or mGal."""
        return (
            text.number(abs(self.error), 2)
            if self.quantity[0] == "1"
            else f"{text.number(abs(self.error) / MGAL, 2)} mGal"
        )

    @property
    def acts_as(self) -> str:
        """The sensor error of the same size."""
        if self.quantity[0] == "1":
            drift = abs(self.error) * CRUISE_M_S / 6.371e6
            return f"{text.number(math.degrees(drift) * 3600.0, 2)} deg/h at {CRUISE_M_S:.0f} m/s"
        axis = "vertical" if self.quantity.endswith("down") else "horizontal"
        return f"{text.number(abs(self.error) / 9.80665e-6, 2)} ug, {axis}"


@dataclass(frozen=True)
class EarthVariants:
    """All simplified forms over latitudes from pole to pole and heights from 0 to ``top_m``."""

    ellipsoid: str
    top_m: float
    errors: tuple[VariantError, ...]

    def __getitem__(self, key: tuple[str, str]) -> VariantError:
        return next(e for e in self.errors if (e.quantity, e.form) == key)

    def table(self) -> str:
        """One line per form."""
        rows = [
            [e.quantity, e.form, e.shown, f"{abs(e.lat_deg):.0f}", f"{e.height_m / 1e3:.0f}", e.acts_as]
            for e in self.errors
        ]
        title = f"Largest error, heights 0 to {self.top_m / 1e3:.0f} km, {self.ellipsoid}"
        head = ["quantity", "form", "error", "at lat, deg", "km", "acts as"]
        return text.table(title, head, rows, left=(0, 1, 5))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers: relative errors, m/s^2."""
        return {
            "ellipsoid": self.ellipsoid,
            "top_m": self.top_m,
            "errors": [
                {
                    "quantity": e.quantity,
                    "form": e.form,
                    "error": e.error,
                    "lat_deg": e.lat_deg,
                    "height_m": e.height_m,
                }
                for e in self.errors
            ],
        }


def inverse_radii(
    form: str, lat_rad: ArrayLike, height_m: ArrayLike, ellipsoid: str = "wgs84"
) -> tuple[Array, Array]:
    """1/(R_M + h) and 1/(R_P + h), 1/m.

    Parameters
    ----------
    form : {"closed", "short", "short, printed", "long"}
        Closed form, first-order or second-order series in e^2 and h/a; ``"short, printed"`` has the wrong sign of e^2
        in the meridian radius.
    lat_rad, height_m : array_like, shape (k,)
        Latitude and height.
    ellipsoid : str
        ``"wgs84"``, ``"grs80"``, ``"pz90"``, ``"krasovsky"``.

    Returns
    -------
    tuple of ndarray, shape (k,)
    """
    lat, height = _vectors(lat_rad, height_m)
    if form == "closed":
        radii = _core.radii(lat, ellipsoid) + height[:, None]
        return 1.0 / radii[:, 0], 1.0 / radii[:, 1]
    point = _point(lat, height, ellipsoid)
    prime = form.removesuffix(", printed")
    return _formula(_MERIDIAN, form)(point), _formula(_PRIME, prime)(point)


def gravity_down(form: str, lat_rad: ArrayLike, height_m: ArrayLike, ellipsoid: str = "wgs84") -> Array:
    """Gravity along the plumb line, m/s^2, shape (k,).

    ``form`` is ``"closed"`` (Somigliana with second-order free air, as in the engine) or one of
    ``EARTH_FORMS["gravity down"]``.
    """
    lat, height = _vectors(lat_rad, height_m)
    if form == "closed":
        return np.asarray(_core.gravity_n(lat, height, ellipsoid)[:, 2])
    return _formula(_DOWN, form)(_point(lat, height, ellipsoid))


def gravity_north(form: str, lat_rad: ArrayLike, height_m: ArrayLike, ellipsoid: str = "wgs84") -> Array:
    """North component of gravity at height, m/s^2, shape (k,): ``"closed"``, ``"series"`` or ``"none"``."""
    lat, height = _vectors(lat_rad, height_m)
    if form == "closed":
        return np.asarray(_core.gravity_n(lat, height, ellipsoid)[:, 0])
    return _formula(_NORTH, form)(_point(lat, height, ellipsoid))


def earth_variants(ellipsoid: str = "wgs84", top_m: float = 20_000.0) -> EarthVariants:
    """Largest error of every simplified form of radii and gravity.

    Parameters
    ----------
    ellipsoid : str
        Ellipsoid of the closed forms and of the series.
    top_m : float
        Greatest height, m; the least is 0.

    Returns
    -------
    EarthVariants
    """
    lat = np.tile(np.radians(np.linspace(-90.0, 90.0, 181)), 41)
    height = np.repeat(np.linspace(0.0, top_m, 41), 181)
    m, n = inverse_radii("closed", lat, height, ellipsoid)
    closed = {
        "1/(R_M+h)": m,
        "1/(R_P+h)": n,
        "gravity down": gravity_down("closed", lat, height, ellipsoid),
        "gravity north": gravity_north("closed", lat, height, ellipsoid),
    }
    formulas = {
        "1/(R_M+h)": _MERIDIAN,
        "1/(R_P+h)": _PRIME,
        "gravity down": _DOWN,
        "gravity north": _NORTH,
    }
    point = _point(lat, height, ellipsoid)
    errors = []
    for quantity, forms in formulas.items():
        for form, formula in forms.items():
            error = formula(point) - closed[quantity]
            if quantity[0] == "1":
                error = error / closed[quantity]
            worst = int(np.argmax(np.abs(error)))
            at = float(np.degrees(lat[worst])), float(height[worst])
            errors.append(VariantError(quantity, form, float(error[worst]), *at))
    return EarthVariants(ellipsoid, top_m, tuple(errors))


def _vectors(lat_rad: ArrayLike, height_m: ArrayLike) -> tuple[Array, Array]:
    lat, height = np.broadcast_arrays(
        np.atleast_1d(np.asarray(lat_rad, dtype=np.float64)), np.asarray(height_m, dtype=np.float64)
    )
    return np.ascontiguousarray(lat), np.ascontiguousarray(height)


def _point(lat: Array, height: Array, ellipsoid: str) -> _Point:
    equator = _core.radii(np.zeros(1), ellipsoid)[0]
    a = float(equator[1])
    return _Point(a, 1.0 - float(equator[0]) / a, height / a, np.sin(lat), np.cos(lat))


def _formula(forms: dict[str, _Formula], form: str) -> _Formula:
    if form not in forms:
        known = ", ".join(f'"{name}"' for name in ("closed", *forms))
        raise ConfigError("config.choice", f'form "{form}" is not known', f"use one of {known}")
    return forms[form]
