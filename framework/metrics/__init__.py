"""PSNR, SSIM, FLIP and LPIPS of renders (`evaluate`), and types of measurements (`values`, light).

`coadaptation` measures how much Gaussians depend on each other and how flat they are.
"""

__all__ = ["coadaptation", "evaluate", "flip", "lpips", "lpips_weights", "values"]
