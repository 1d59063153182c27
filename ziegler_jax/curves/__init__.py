"""Curves in the plane of two parameters, along which cycles bifurcate."""
