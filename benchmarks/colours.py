"""Okabe and Ito's colours, which the colour-blind can tell apart."""

BLUE, VERMILLION, SKY = "#0072B2", "#D55E00", "#56B4E9"
LINES = (BLUE, VERMILLION, "#009E73", "#CC79A7", "#E69F00", SKY, "#000000")
