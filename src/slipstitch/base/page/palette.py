"""The colours of all pages and pictures."""

# Okabe & Ito 2008: distinguishable for colour-blind readers.
BLUE, ORANGE, GREEN, PINK = "#0072B2", "#E69F00", "#009E73", "#CC79A7"
SKY, VERMILION, BLACK = "#56B4E9", "#D55E00", "#000000"
# For curves that have no colour of their own, in this order.
SERIES = (BLUE, ORANGE, GREEN, PINK, SKY, VERMILION, BLACK)

# Theory is black, what was measured is vermilion, on every picture.
THEORY, MEASURED = "#1a1a1a", VERMILION

INK, SOFT, FAINT, PALE = "#23262b", "#5b5e63", "#8c8c8c", "#b9bcc0"
FRAME, LINE = "#b8b6b0", "#e4e1d9"
GOOD, BAD, DOUBT = "#00694d", "#a63d00", "#c9a227"
INTERVAL = "#dce9f2"  # band of an interval
PALE_BLUE = "#b9d3e6"

# Variables of the style sheet, by day and by night. Pictures are drawn in dark ink: what is behind
# them stays light.
STYLE_SHEET = {
    "paper": "#fbfaf7",
    "card": "#ffffff",
    "ink": INK,
    "soft": SOFT,
    "line": LINE,
    "accent": "#0b5f8a",
    "good": GOOD,
    "bad": BAD,
    "doubt": DOUBT,
    "wash": "#f1efe8",
    "rule": "#c9c5ba",
    "absent": "#6d6c68",
    "good-wash": "#eaf3ee",
    "bad-wash": "#fdeee7",
    "doubt-wash": "#f5f0df",
}
DARK = {
    "paper": "#17191c",
    "card": "#202327",
    "ink": "#e6e4de",
    "soft": "#a9aaa8",
    "line": "#34373b",
    "accent": "#7dbfe6",
    "good": "#5cc9a0",
    "bad": "#ff9a66",
    "doubt": "#d9b84a",
    "wash": "#25282c",
    "rule": "#4b4e52",
    "absent": "#9a9b9e",
    "good-wash": "#17302a",
    "bad-wash": "#3a2119",
    "doubt-wash": "#322c17",
}
