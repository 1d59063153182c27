"""Questions about motions: cycles, branches, thresholds, exponents."""
