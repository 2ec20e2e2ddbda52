"""Lines and texts in the plot over the frames."""

from xml.etree import ElementTree

from cageik_cli.report.plots.error_plot import draw_plot, render_plot_svg
from cageik_cli.report.plots.style import use_fixed_style


def drawn(report):
    """The figure of the plot, in the style of all plots."""
    with use_fixed_style():
        return draw_plot(report)


def lines(report, gid):
    """The lines with this gid, those of the left axes first."""
    axes = drawn(report).axes
    return [line for axis in axes for line in axis.lines if line.get_gid() == gid]


def texts(report):
    """All texts, as a browser shows them."""
    root = ElementTree.fromstring(render_plot_svg(report))
    return [element.text for element in root.iter("{http://www.w3.org/2000/svg}text")]
