"""The numbers under a colour scale or a histogram."""

TICK_COUNT = 5


def format_ticks(top: float, bottom: float = 0.0) -> list[str]:
    """Format evenly spaced numbers from `bottom` to `top`."""
    steps = TICK_COUNT - 1
    numbers = [bottom + (top - bottom) * k / steps for k in range(TICK_COUNT)]
    return [f"{number:.4g}".replace("-", "\N{MINUS SIGN}") for number in numbers]
