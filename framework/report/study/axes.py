"""Options that a report draws along an axis: budgets buy quality with time, stresses make the data
harder.

A budget is part of a method's name, a stress part of a scene's; what remains of the names ties the
points of a curve together.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Axis:
    """key: of the configuration. label: with its unit. harder: +1 if larger values are harder.
    at: a value in a sentence."""

    key: str
    label: str
    harder: int
    at: str

    @property
    def short(self) -> str:
        """The option's own name, as `n_views`."""
        return self.key.rpartition(".")[2]


VIEWS = "scene.n_views"  # `all` of them is their number here
STRESSES = (
    Axis(VIEWS, "training views", -1, "{} training views"),
    Axis("depth.strength", "strength of the depth error", 1, "strength {}"),
    Axis("scene.spread", "camera spread (m)", 1, "a spread of {} m"),
    Axis("scene.pose_noise", "pose noise (px)", 1, "a noise of {} px"),
    Axis("scene.texture", "texture contrast (factor)", -1, "a contrast of {}"),
    Axis("scene.downscale", "shrinking of the photos (factor)", 1, "a shrinking by {}"),
    Axis("scene.gloss", "gloss (factor)", 1, "a gloss of {}"),
)
# part of the conditions a method meets, without an order of their own
CONDITIONS = ("depth.corruption",)
DATA_KEYS = (*(axis.key for axis in STRESSES), *CONDITIONS)
# of a method; the capacity plugin and its options are one, too
STEPS = "trainer.steps"
WITH_STEPS = (  # what presets set together with the steps
    *("trainer.visits", "trainer.coarse_factor", "trainer.coarse_until"),
    *("trainer.members", "trainer.kept", "trainer.tuning"),
)
SECONDS = "trainer.seconds"
CHOSEN_BY_TIME = (STEPS, "trainer.visits")  # without effect if that is set
BUDGETS = (STEPS, *WITH_STEPS, "init.budget", "init.per_pixel")
