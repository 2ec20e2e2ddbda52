"""The coefficients of `cageik_cli/kernel/functions.h`, by the exchange of Remez (1934).

ln((1 + s) / (1 - s)) = 2 s + s z P(z) and arctan t = t + t z P(z), with z = s² or t². P is a power
series; the polynomial in its place leaves the smallest error of z P(z), which is that of the result
in parts of its first term. `python -m tests.method.weights.bem.derive_functions` prints the lines.
"""

from decimal import Decimal, getcontext

import numpy as np

getcontext().prec = 50

SERIES_TERMS = 100
"""Enough for 50 digits where z is at most 0.31."""

GRID = 1000
"""Places among which the largest errors are sought."""

LOG_TERMS, ARCTAN_TERMS = 7, 13
"""Coefficients: the fewest that leave an error far below that of rounding."""

LN_2 = Decimal("0.69314718055994530941723212145817656807550013436026")
PI = Decimal("3.14159265358979323846264338327950288419716939937511")


def find_minimax(series, end, count):
    """The `count` coefficients for z from 0 to `end`, and the largest error of z P(z)."""
    angles = np.linspace(0, np.pi / 2, GRID + 1)[1:]
    z = np.array([end * Decimal(float(share)) for share in np.sin(angles) ** 2])
    exact = z * evaluate(series, z)
    places = np.linspace(0, GRID - 1, count + 1).round().astype(int)
    for _ in range(20):
        rows = [[*(z[k] ** (n + 1) for n in range(count)), Decimal((-1) ** i), exact[k]]
                for i, k in enumerate(places)]  # fmt: skip
        coefficients = solve(rows)[:-1]
        errors = z * evaluate(coefficients, z) - exact
        previous, places = places, find_alternation(errors)
        if np.array_equal(places, previous):
            return coefficients, max(abs(errors))
    raise ArithmeticError("the exchange does not end")


def find_alternation(errors):
    """The place of the largest error between changes of sign."""
    changes = np.flatnonzero(np.diff(errors > 0)) + 1
    bounds = zip([0, *changes], [*changes, len(errors)], strict=True)
    return np.array([begin + np.abs(errors[begin:end]).argmax() for begin, end in bounds])


def evaluate(coefficients, z):
    """The polynomial at each place."""
    value = 0 * z
    for coefficient in reversed(coefficients):
        value = value * z + coefficient
    return value


def solve(rows):
    """The solution of a linear system, by elimination; rows end with the right-hand side."""
    rows = np.array(rows)
    for k in range(len(rows)):
        pivot = k + int(np.abs(rows[k:, k]).argmax())
        rows[[k, pivot]] = rows[[pivot, k]]
        rows[k] /= rows[k, k]
        others = np.arange(len(rows)) != k
        rows[others] -= rows[others, k][:, None] * rows[k]
    return list(rows[:, -1])


def derive_log():
    """The coefficients for s up to 3 - √8, which is that of √2, and their error."""
    series = [2 / Decimal(2 * k + 3) for k in range(SERIES_TERMS)]
    return find_minimax(series, (3 - Decimal(8).sqrt()) ** 2, LOG_TERMS)


def derive_arctan():
    """The coefficients for t up to 0.55, and their error."""
    series = [(-1) ** (k + 1) / Decimal(2 * k + 3) for k in range(SERIES_TERMS)]
    return find_minimax(series, Decimal("0.55") ** 2, ARCTAN_TERMS)


def split(number, bits):
    """A number as a double of as many bits, and the rest."""
    scale = Decimal(2) ** bits
    high = float((number * scale).to_integral_value() / scale)
    return high, float(number - Decimal(high))


def format_constants():
    """The lines of the header, each as C reads it."""
    lines = []
    for name, derive in (("LOG", derive_log), ("ARCTAN", derive_arctan)):
        values = ", ".join(repr(float(value)) for value in derive()[0])
        lines.append(f"{name}[] = {{{values}}};")
    for name, number, bits in (("LN_2", LN_2, 42), ("PI", PI, 51)):
        high, rest = split(number, bits)
        lines.append(f"{name}[] = {{{high!r}, {rest!r}}};")
    return lines


if __name__ == "__main__":
    print(*format_constants(), sep="\n")
    for name, derive in (("log", derive_log), ("arctan", derive_arctan)):
        print(f"// {name}: 2^{float(derive()[1].ln() / Decimal(2).ln()):.1f}")
