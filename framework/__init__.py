"""fishersplat: a config-driven framework for sparse-view 3D Gaussian Splatting on a CPU."""

__version__ = "0.1.0"
