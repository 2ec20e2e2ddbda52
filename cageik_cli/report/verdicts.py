"""What is said of limits."""

from collections.abc import Sequence
from dataclasses import dataclass

from cageik_cli.report.figures import percent_text, units_text
from cageik_cli.report.gates import PERCENT, Gate


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is said of limits.

    Attributes
    ----------
    state : str
        "good", "bad" or "none": how it is coloured.
    text : str
    """

    state: str
    text: str


def gate_verdict(gate: Gate) -> Verdict:
    """What is said of one limit."""
    return {
        True: Verdict("good", "within limit"),
        False: Verdict("bad", "over limit"),
        None: Verdict("none", "not judged"),
    }[gate.passed]


def verdict_of(gates: Sequence[Gate]) -> Verdict:
    """What is said of all limits of a result."""
    if not gates:
        return Verdict("none", "No limits were stated")
    over = sum(gate.passed is False for gate in gates)
    kept = sum(gate.passed is True for gate in gates)
    rest = len(gates) - over - kept
    unjudged = f"; {rest} could not be judged" if rest else ""
    if over:
        share = f"{over} of {len(gates)} limits" if len(gates) > 1 else "the limit"
        return Verdict("bad", f"Over {share}{unjudged}")
    if kept:
        share = "the limit" if len(gates) == 1 else f"{kept} of {len(gates)} limits"
        return Verdict("good", f"Within {share}{unjudged}")
    return Verdict("none", "No limit could be judged")


def most_text(gate: Gate) -> str:
    """The limit as it was typed, or as figures are printed when it was made of one."""
    return f"{gate.limit:.10g}" if gate.baseline is None else percent_text(gate.limit)


def limit_text(gate: Gate, unit: str = "") -> str:
    """The limit, and what it was made of if it was not typed; `unit` is put behind numbers."""
    limit = f"{most_text(gate)}{unit}"
    if gate.baseline is None:
        return limit
    return f"{limit} (baseline {percent_text(gate.baseline)}{unit})"


def found_text(gate: Gate) -> str:
    """What was found, as it is printed everywhere."""
    if gate.found is None:
        return "not defined"
    return percent_text(gate.found) if gate.unit == PERCENT else units_text(gate.found)
