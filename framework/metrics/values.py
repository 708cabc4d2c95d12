"""What a measurement is: a number, or why there is none. Light to import: reports read these."""

from __future__ import annotations

from dataclasses import dataclass

METRICS = ("psnr", "ssim", "flip", "lpips", "lpips_01")


@dataclass(frozen=True)
class Missing:
    """A value that does not exist, and why."""

    reason: str


Measurement = float | Missing


@dataclass(frozen=True)
class ViewMetrics:
    """One test view: psnr in dB, ssim, flip, lpips, lpips_01, each or why missing; render_s
    in s."""

    view: str
    tags: tuple[str, ...]
    psnr: Measurement
    ssim: Measurement
    flip: Measurement
    lpips: Measurement
    lpips_01: Measurement
    render_s: float

    def value(self, metric: str) -> Measurement:
        """The measurement named `metric`, one of `METRICS`."""
        return getattr(self, metric)
