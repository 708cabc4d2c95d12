"""The figures of the paper this project follows, to stand beside ours. Other data sets, hardware
and numbers of steps: they place our numbers, they are no comparison."""

from __future__ import annotations

from framework.report.parts.document import Table

SOURCE = (
    "Published figures on other data sets, for orientation: LLFF (8 scenes, 3 views, 1/8 size), DTU"
    " (15 scans, 3 views, masked), Mip-NeRF 360 (12 views, 1/8 size), trained on a GPU for 10,000"
    " steps or more; not comparable with the numbers above. SAFI + UAR as in arXiv 2606.20842, the"
    " others as their papers or later ones give them. DropGaussian is the best of 5 runs; the mean"
    " of 10 independent runs is 20.46 dB with σ 0.21 (arXiv 2511.17918). SAFI's paper gives σ_PSNR"
    " of its baseline and method as 0.084 and 0.027, and 0.061 and 0.026, without the number of"
    " runs."
)
PUBLISHED = Table(
    ("Method", "LLFF PSNR / SSIM / LPIPS", "DTU PSNR / SSIM / LPIPS", "360 PSNR / SSIM / LPIPS"),
    (
        ("3DGS", "19.22 / 0.649 / 0.229", "10.99 / – / –", "18.52 / 0.523 / 0.415"),
        ("FSGS", "20.43 / 0.682 / 0.248", "17.34 / – / –", "18.80 / – / –"),
        ("CoR-GS", "20.45 / 0.712 / 0.196", "19.21 / 0.853 / 0.119", "19.52 / – / –"),
        ("DropGaussian", "20.76 / 0.713 / 0.200", "–", "19.74 / 0.577 / 0.364"),
        ("SAFI + UAR", "21.12 / 0.729 / 0.190", "22.44 / 0.900 / 0.092", "20.09 / 0.591 / 0.360"),
    ),
    ("Method",),
)
