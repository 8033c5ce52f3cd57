"""Moduli in the units that people read."""

import math

_PREFIXES = ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa"))


def format_pascals(value: float) -> str:
    """Return a modulus [Pa] with three significant digits, such as `1.23 MPa`."""
    scale, unit = _scale(value)
    return f"{_digits(value / scale)} {unit}"


def format_pascals_range(low: float, high: float) -> str:
    """Return an interval [Pa], such as `0.12–2.6 MPa`.

    It has two units, such as `3.9 kPa–1.0 MPa`, if its low end is less than a tenth of the unit of its high end.
    """
    scale, unit = _scale(high)
    if low < 0.1 * scale:
        return "–".join(f"{_digits(value / own, 2)} {name}" for value in (low, high) for own, name in [_scale(value)])
    return f"{_digits(low / scale, 2)}–{_digits(high / scale, 2)} {unit}"


def _scale(value: float) -> tuple[float, str]:
    return next((pair for pair in _PREFIXES if value >= pair[0]), (1.0, "Pa"))


def _digits(value: float, count: int = 3) -> str:
    """Return `count` significant digits without exponent."""
    if value <= 0 or not math.isfinite(value):
        return f"{value:g}"
    places = max(0, count - 1 - math.floor(math.log10(value)))
    return f"{value:.{places}f}"
