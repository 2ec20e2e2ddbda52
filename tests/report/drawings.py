"""Lines and texts in the plot over the frames."""

from xml.etree import ElementTree

from cageik_cli.report.plots.error_plot import draw_plot, render_plot_svg


def lines(report, gid):
    """The lines with this gid, those of the left axes first."""
    axes = draw_plot(report).axes
    return [line for axis in axes for line in axis.lines if line.get_gid() == gid]


def texts(report):
    """All texts, as a browser shows them."""
    root = ElementTree.fromstring(render_plot_svg(report))
    return [element.text for element in root.iter("{http://www.w3.org/2000/svg}text")]
