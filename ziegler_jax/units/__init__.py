"""SI units: a device in kilograms, metres and newtons, results in seconds."""
