"""Attitude from gyro, accelerometer and magnetometer: published correction laws and a production filter."""

from __future__ import annotations

__all__: list[str] = []
