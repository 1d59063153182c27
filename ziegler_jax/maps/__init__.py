"""Boundaries of maps with a width, and unions of maps."""
