"""PSNR, SSIM, FLIP and LPIPS of renders (`evaluate`); what a measurement is (`values`, light); how
far Gaussians lean on each other (`coadaptation`) and how flat they are (`rank`)."""

__all__ = ["coadaptation", "evaluate", "flip", "lpips", "lpips_weights", "values"]
