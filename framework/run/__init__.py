"""One run: scene -> depth -> start -> training -> measures -> record (`experiment`).

`training` trains once or as several members, `warmup` loads kernels meanwhile.
"""

__all__ = ["experiment", "members", "training", "warmup"]
