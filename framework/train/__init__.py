"""The step loop: `trainer` picks a view, renders, takes the loss's gradient, steps and edits.

`schedule` has what changes over a training, `optim` the update, `plugged` the plugins at work,
`resume/` what a checkpoint holds.
"""

__all__ = ["epoch", "gradient", "guard", "optim", "resume", "schedule", "trainer"]
