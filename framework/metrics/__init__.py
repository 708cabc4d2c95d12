"""PSNR, SSIM, FLIP and LPIPS of renders (`evaluate`); what a measurement is (`values`, light)."""

__all__ = ["evaluate", "flip", "lpips", "lpips_weights", "values"]
