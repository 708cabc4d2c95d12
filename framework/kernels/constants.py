"""The constants of the 3DGS rasterizer (Kerbl et al. 2023, reference implementation)."""

ALPHA_MIN = 1.0 / 255.0  # a fainter (pixel, Gaussian) pair is skipped
ALPHA_MAX = 0.99
TRANSMITTANCE_MIN = 1e-4  # a pixel that would fall below it is finished
FRUSTUM_MARGIN = 0.25  # a centre farther outside the image than this share of its size is culled
TILE = 16  # pixels
WHOLE = 0.999  # of a mask, from which a pixel is in it
ROW = 16  # floats of a projected Gaussian, see projection.py
