"""What a page says of weights and system: figures, what they mean, and what is good."""

from dataclasses import dataclass

from cageik_cli.cages.bind import LOWEST_WEIGHT
from cageik_cli.coordinates.binding import WeightQuality
from cageik_cli.coordinates.weights import ACCURACIES
from cageik_cli.report.record import Report
from cageik_cli.report.wording import wording_of
from cageik_cli.solver.dual_laplacian import WORST_CONDITION


@dataclass(frozen=True, slots=True)
class QualityRow:
    """A figure as it is printed, what it means, and what is good; "" if nothing is better."""

    label: str
    found: str
    meaning: str
    good: str


def quality_rows(report: Report) -> list[QualityRow]:
    """The figures of a report's weights, then that of its system."""
    found, settings = report.binding, report.settings
    return [
        *_exactness(found),
        _smallest(found, is_harmonic=settings.get("coordinates") == "harmonic"),
        *_accuracy(found, str(settings.get("accuracy"))),
        QualityRow(
            "Projected vertices",
            str(found.projected),
            "They lay outside the cage, and have the weights of its nearest point.",
            "0",
        ),
        QualityRow(
            "Condition number",
            f"{found.condition_number:.4g}",
            wording_of(report.edited_from).condition,
            f"far below {WORST_CONDITION:.0e}, where a run is refused",
        ),
    ]


def _exactness(found: WeightQuality) -> list[QualityRow]:
    """What holds of weights of any kind, but for rounding."""
    return [
        QualityRow(
            "Rows sum to 1 within",
            f"{found.partition_of_unity:.1e}",
            "How far the sum of a vertex's weights is from one; where it is not one, moving "
            "the cage does not move the model as far.",
            "rounding: 1e-10 or less",
        ),
        QualityRow(
            "Rest pose rebuilt within",
            f"{found.linear_precision:.1e}",
            "Largest distance of the weights times the rest cage from the rest pose, in "
            "diagonals; affine motions come out as exactly.",
            "rounding: 1e-10 or less",
        ),
    ]


def _smallest(found: WeightQuality, is_harmonic: bool) -> QualityRow:
    label, smallest = "Smallest weight", f"{found.min_weight:.1e}"
    if is_harmonic:
        meaning = "Exact harmonic weights are never negative, so this is a measure of their error."
        return QualityRow(label, smallest, meaning, f"{LOWEST_WEIGHT} or more")
    meaning = (
        "Mean value weights are negative across concave parts of a cage; the model moves "
        "against the cage there."
    )
    return QualityRow(label, smallest, meaning, "close to zero")


def _accuracy(found: WeightQuality, asked: str) -> list[QualityRow]:
    """How far weights are from exact ones, and what was divided for that."""
    if not found.panels:
        return [QualityRow("Accuracy", "exact", "These weights are in closed form.", "")]
    accuracy = ACCURACIES.get(asked)
    return [
        QualityRow(
            "Mean row L1 error, estimated",
            f"{found.estimated_error:.1e}",
            "How far a vertex's weights are from exact ones, summed over the cage and "
            "averaged over the vertices.",
            f"{accuracy.tolerance:g} or less, as asked for" if accuracy else "",
        ),
        QualityRow(
            "Panels",
            str(found.panels),
            "Triangles that the cage's faces were divided into to compute the weights.",
            "as many as the accuracy needs",
        ),
    ]
