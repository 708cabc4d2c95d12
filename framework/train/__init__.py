"""The step loop: `trainer` picks a view, renders, takes the loss's gradient, steps and edits.

`schedule` has what changes over a training, `descent`, `optim` and `torch_adam` the update,
`plugin_calls` the plugins at work, `dose` how much they did, `resume/` what a checkpoint holds.
"""

__all__ = [
    "dose",
    "epoch",
    "gradient",
    "guard",
    "optim",
    "resume",
    "schedule",
    "torch_adam",
    "trainer",
]
