"""Okabe and Ito's colours, which the colour-blind can tell apart, and paler ones."""

BLUE, ORANGE, GREEN, VERMILLION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
SKY, PURPLE, GREY = "#56B4E9", "#CC79A7", "#BBBBBB"
PALE_BLUE, PALE_ORANGE = "#D9E8F4", "#FBE6D0"
REST = "#E8DCC8"  # as `zj.plot.map` shows it
