"""The paper's figures that stand beside ours (Rasheed et al., CVPR 2020)."""

CITATION = (
    "Rasheed, Romero, Bertails-Descoubes, Wuhrer, Franco, Lazarus: Learning to Measure the Static "
    "Friction Coefficient in Cloth Contact, CVPR 2020"
)

# Shares of test videos. Only what is known here of the paper's Table 2 and its Sec. 6.2.1; a cell
# that is not listed is shown as not available.
TABLE_2 = {
    ("material_baseline", "material_top1"): 0.995,
    ("friction_conditional", "friction_lt_0.1"): 0.955,
    ("friction_conditional", "friction_lt_0.2"): 0.992,
}
UNSEEN_TEXTURE = {
    ("friction_conditional", "friction_lt_0.1"): 0.872,
    ("friction_conditional", "friction_lt_0.2"): 0.95,
}
