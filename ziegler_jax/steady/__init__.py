"""Where motions end up: what is steady, and the certificate that it is."""
