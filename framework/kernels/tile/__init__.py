"""Rows -> pixels: which tiles a Gaussian touches (`tiles`, `binning`), blending front to back
(`blend`), second moments over pixels (`moments`)."""
