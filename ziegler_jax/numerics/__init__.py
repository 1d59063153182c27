"""Numbers, series, polynomials, elementary functions: nothing here knows a column."""
