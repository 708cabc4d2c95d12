"""PSNR, SSIM, FLIP and LPIPS of renders (`evaluate`); what a measurement is (`values`, light); how
far Gaussians lean on each other (`coadaptation`)."""

__all__ = ["coadaptation", "evaluate", "flip", "lpips", "lpips_weights", "values"]
