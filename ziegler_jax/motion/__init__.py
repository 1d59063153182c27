"""One motion: integrated, settled, observed."""
