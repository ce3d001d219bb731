"""The colours of all pages and pictures, and matplotlib's style."""

from typing import Any

# Okabe & Ito 2008: distinguishable for colour-blind readers.
BLUE, ORANGE, GREEN, PINK = "#0072B2", "#E69F00", "#009E73", "#CC79A7"
SKY, VERMILION, BLACK = "#56B4E9", "#D55E00", "#000000"
# For curves that have no colour of their own, in this order.
SERIES = (BLUE, ORANGE, GREEN, PINK, SKY, VERMILION, BLACK)

# Theory is black, what was measured is vermilion, on every picture.
THEORY, MEASURED = "#1a1a1a", VERMILION

INK, SOFT, FAINT, PALE = "#23262b", "#5b5e63", "#8c8c8c", "#b9bcc0"
FRAME, LINE = "#b8b6b0", "#e4e1d9"
GOOD, BAD, DOUBT = "#00694d", "#a63d00", "#c9a227"  # as in templates/style.css
INTERVAL = "#dce9f2"  # band of an interval
PALE_BLUE = "#b9d3e6"

# Ids that do not differ from run to run.
FIXED_IDS: Any = {"svg.hashsalt": "slipstitch"}

STYLE: Any = {
    **FIXED_IDS,
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9,
    "axes.edgecolor": FRAME,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "path.simplify": True,
}
