"""The linear column: spectra, critical loads, their derivatives."""
