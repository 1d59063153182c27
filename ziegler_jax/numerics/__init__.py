"""Numbers, series, polynomials, elementary functions: nothing here imports a column."""
