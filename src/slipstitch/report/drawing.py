"""How the report's figures look, and how they become SVG."""

import io

import matplotlib

matplotlib.use("Agg")

from matplotlib.figure import Figure

INK = "#23262b"
# Okabe & Ito 2008, as are the colours of the calibration.
BLUE, GREEN, ORANGE, PINK = "#0072B2", "#009E73", "#E69F00", "#CC79A7"

STYLE = {
    "svg.hashsalt": "slipstitch",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9,
    "axes.edgecolor": "#b8b6b0",
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": "#5b5e63",
    "ytick.color": "#5b5e63",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "path.simplify": True,
}


def svg(figure: Figure) -> str:
    """A figure as the text of an SVG."""
    buffer = io.StringIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, in inches."""
    return Figure(figsize=(width, height), layout="constrained")


def styled(function):
    """Apply the style while the figure is drawn, not only while it is saved."""

    def draw(*arguments, **options):
        with matplotlib.rc_context(STYLE):
            return function(*arguments, **options)

    draw.__doc__ = function.__doc__
    draw.__name__ = function.__name__
    return draw
