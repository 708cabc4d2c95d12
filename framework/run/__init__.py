"""One run: scene -> depth -> start -> training -> measures -> record (`experiment`).

`training` trains once or as several members, `warmup` loads kernels meanwhile, `trackers` sends
what a finished run logged to TensorBoard and the like.
"""

__all__ = ["experiment", "members", "trackers", "training", "warmup"]
