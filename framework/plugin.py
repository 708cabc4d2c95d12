"""THE contracts: what a plugin gets and what it returns.

A plugin is one file with one frozen dataclass whose typed fields are its options:

    @register("augment", "mirror")
    @dataclass(frozen=True)
    class Mirror(Augmenter):
        every: int = 1

Augmenters, regularizers and capacities act on a training; scene loaders, depth providers,
initializers and metrics are parts of a run, with the same registration and neither framework keys
nor state (below: `Part`).

`name` chooses it; `weight`, `start` and `stop` are framework keys every plugin has. State is
explicit: `init_state` makes it, every hook gets it and returns the next one, checkpoints hold it.
A plugin validates its options in `__post_init__` with `check`.

This module, and so every plugin module, is imported to list options: heavy libraries are imported
inside the methods that need them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

from framework.depth import DepthProvider
from framework.errors import check_option
from framework.registry import BASES, register

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from framework.fisher.information import FisherInformation
    from framework.types import DepthMap, Gaussians, Render, Scene, TrainingSet, View
    from framework.warp.zbuffer import Support

__all__ = [
    "Augmenter",
    "Capacity",
    "DepthProvider",
    "Edits",
    "GradientAt",
    "Initializer",
    "Metric",
    "Regularizer",
    "SceneLoader",
    "StepContext",
    "StepStats",
    "SubStep",
    "register",
]


def _made(key: str, make: Callable[[], Any]) -> Any:
    return make()


@dataclass(frozen=True)
class StepContext:
    """What a plugin may read: the training at one moment, without test views.

    Attributes:
        step: index of the step about to run, from 0; in `Capacity.update` the one just done.
        views: the real training views, at full size.
        depth: their depth maps, in the same order.

        gaussians: the current ones, detached except in `Regularizer.loss` and `substeps`. Clone
            what is kept, as the next step changes them in place.
        version: changes whenever Gaussians were added, removed or reordered.

        sh_degree: the active degree.
        background: [3].
        extent: see `TrainingSet.extent`, in scene units.
        spacing: mean distance of a training camera to the nearest other one.

        near, far: depth bounds of the scene, in scene units.
        behind: [3], the background of this step's renders (random with
            `trainer.background=random`).

        other: the second field before this step, detached (`Plugin.second_field`).
        second: whether the plugin's Gaussians are the second field, which is not kept.

    Functions:
        supports(): the training views prepared for warping (`framework.warp`).

        render(camera): render the current Gaussians without dropout and without a gradient.
            `render(camera, gaussians, opacity_factors=[N], background=[3])` renders any Gaussians
            and is differentiable in them and in the factors.

        fisher(camera): Fisher information of the current Gaussians. `fisher(camera, gaussians,
            sh_degree, mask)` takes others, for instance a snapshot, and only a photo's pixels.

        once(key, make): the value of `make()`, computed once per training and shared by all
            plugins. Begin the key with the plugin's name, and do not write into the value.

        rng(purpose): the plugin's random stream for this update.
        log(name, value): log into the history, and the mean over the training into the run's dose.
    """

    step: int
    n_steps: int
    epoch: int
    views: tuple[View, ...]
    depth: tuple[DepthMap, ...]
    gaussians: Gaussians
    version: int
    sh_degree: int
    background: Tensor
    extent: float
    spacing: float
    near: float
    far: float
    supports: Callable[[], tuple[Support, ...]]
    render: Callable[..., Render]
    fisher: Callable[..., FisherInformation]
    rng: Callable[[str], np.random.Generator]
    log: Callable[[str, float], None]
    behind: Tensor | None = None
    other: Gaussians | None = None
    second: bool = False
    once: Callable[[str, Callable[[], Any]], Any] = _made

    @property
    def progress(self) -> float:
        """Share of the training already done, in [0, 1)."""
        return self.step / self.n_steps

    def steps_of(self, share: float) -> int:
        """How many steps that share of the training is, at least one."""
        return max(1, round(share * self.n_steps))

    def due(self, share: float) -> bool:
        """Whether this step is the last of a stretch of `steps_of(share)`."""
        return (self.step + 1) % self.steps_of(share) == 0


class Plugin:
    """Base of all plugins.

    Attributes:
        defaults: changes the defaults of the framework keys.
        idle: a deliberate no-op. Other plugins without any effect cause a warning.
        second_field: train a second set of Gaussians on the same photos, from the same start.

        second_drawn: the second set starts from another draw of the initial Gaussians. An option
            may decide it (`reg=co_register_drawn`).

    The second set has separate draws, optimizer and plugins; `StepContext.other` is the other set.
    """

    name: ClassVar[str]
    group: ClassVar[str]
    defaults: ClassVar[dict[str, float]] = {}
    idle: ClassVar[bool] = False
    second_field: ClassVar[bool] = False
    second_drawn: bool = False

    @classmethod
    def weighted(cls) -> bool:
        """Whether `weight` acts; a value for it is refused otherwise."""
        return True

    def check(self, option: str, ok: bool, expected: str) -> None:
        """Raise UserError, with the option's value and what it should be, unless `ok`."""
        check_option(self, self.group, option, ok, expected)

    def check_span(self, start: float, stop: float) -> None:
        """Raise UserError where the plugin cannot do its work in this share of the training."""

    def init_state(self, ctx: StepContext) -> Any:
        """The state before the first use; None for a plugin without one."""
        return None

    def check_state(
        self, state: Any, gaussians: Gaussians, version: int, views: tuple[View, ...]
    ) -> None:
        """Raise ValueError unless a training of these Gaussians, with this `StepContext.version`
        and these real views, can go on with `state`. It comes from a file, which may be forged: a
        plugin that indexes by its state, or hands it to a kernel, checks it here; see
        `framework.shapes`."""


class Augmenter(Plugin):
    """Makes the pseudo views of an epoch.

    Each joins the step of one real view, drawn at random, and adds its loss times `weight`. With
    `trainer.pseudo_steps=own` it has a separate update. It is not called before `start` and after
    `stop` (shares of the training). Log `NAME_refused_WHY` to record why an epoch has no view, see
    `framework.train.dose`.
    """

    group: ClassVar[str] = "augment"

    def pseudo_views(self, ctx: StepContext, state: Any) -> tuple[list[View], Any]:
        """Called at each epoch's start: its pseudo views (rebuilt, not accumulated)."""
        raise NotImplementedError


# the gradient of the step's loss in every parameter, by name, at other values of the parameters
GradientAt = Callable[["Gaussians"], "Mapping[str, Tensor]"]
# a loss, and the names of the parameters that one step of the optimizer may move to lower it
SubStep = tuple["Tensor", Sequence[str]]


class Regularizer(Plugin):
    """Acts on a training step; evaluation sees it by `evaluated` alone."""

    group: ClassVar[str] = "reg"
    drops: ClassVar[bool] = True  # whether a factor below 1 counts as a Gaussian that was dropped

    @classmethod
    def weighted(cls) -> bool:
        """`weight` multiplies the loss term and the losses of `substeps`."""
        return not (cls.loss is Regularizer.loss and cls.substeps is Regularizer.substeps)

    def opacity_factors(self, ctx: StepContext, state: Any) -> tuple[Tensor | None, Any]:
        """[N] float32 factors on the activated opacities for this update's renders, or None. A
        step has one update, and another for every pseudo view with `trainer.pseudo_steps=own`."""
        return None, state

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        """An unweighted scalar to add to the photometric loss, or None. Here alone
        `ctx.gaussians` are the parameters themselves: the scalar may be differentiated through them
        as through `render`."""
        return None

    def substeps(self, ctx: StepContext, state: Any, view: View) -> Iterator[SubStep]:
        """Yield losses that get a separate step of the optimizer, before that on the photo.

        Each is requested after the step of the one before. `ctx.gaussians` are the parameters.
        view: the step's real one, at the size of the training.
        """
        return iter(())

    def gradient(
        self, ctx: StepContext, state: Any, found: Mapping[str, Tensor], at: GradientAt
    ) -> Mapping[str, Tensor] | None:
        """Return the gradient for the optimizer instead of `found`, or None for `found` itself.

        found: gradient of the step's loss by parameter name, as earlier regularizers left it.
        at(gaussians): the same at other values of the parameters; a second pass over the views.
        """
        return None

    def evaluated(self, ctx: StepContext, gaussians: Gaussians, state: Any) -> Gaussians:
        """Return the Gaussians that are evaluated and kept instead of the trained `gaussians`.

        These are `ctx.gaussians` as earlier regularizers left them. ctx: of the last step, after
        it; its log is discarded.
        """
        return gaussians


@dataclass(frozen=True)
class StepStats:
    """What the last step measured on its real view, before pseudo views.

    Attributes:
        means2d_grad: [N, 2], gradient of the loss in the projected means, in pixels.
        radii: [N] pixels, 0 = culled.
        width, height: of the render.

        factors: [N], the regularizers' opacity factors (0 = dropped), None for none.
        view: the real view.

        gradients: of the parameters that the capacity's `gradients` names, by name. They are of the
            loss on the real view with the regularizers' terms, at the values before the step, while
            `ctx.gaussians` are those after it. `Regularizer.gradient` does not change them.

        absolute: [N, 2], as means2d_grad but summed over absolute values of pixels, of the
            photometric loss. None unless a capacity has `wants_absolute`.
    """

    means2d_grad: Tensor
    radii: Tensor
    width: int
    height: int
    factors: Tensor | None = None
    gradients: Mapping[str, Tensor] = field(default_factory=dict)
    view: View | None = None
    absolute: Tensor | None = None

    def map(self, change: Callable[[Tensor], Tensor]) -> StepStats:
        """With every tensor changed alike, each of which has a row per Gaussian."""

        def changed(tensor: Tensor | None) -> Tensor | None:
            return None if tensor is None else change(tensor)

        return replace(
            self,
            means2d_grad=change(self.means2d_grad),
            radii=change(self.radii),
            factors=changed(self.factors),
            gradients={name: change(tensor) for name, tensor in self.gradients.items()},
            absolute=changed(self.absolute),
        )


@dataclass(frozen=True)
class Edits:
    """A change of the set of Gaussians; their order may change.

    Attributes:
        keep: [N] bool, applied first.
        append: new Gaussians.
        bands: [N] bool, which of the existing ones keep their SH bands above 0; None: all.

        opacity_ceiling: clamp opacities to this value at the end, and reset their moments.
        sh0: [N, 1, 3], new values for the existing ones.
        values: new values of parameters by name. The optimizer's moments stay.
    """

    keep: Tensor | None = None
    append: Gaussians | None = None
    opacity_ceiling: float | None = None
    bands: Tensor | None = None
    sh0: Tensor | None = None
    values: Mapping[str, Tensor] = field(default_factory=dict)

    @property
    def changes_the_rows(self) -> bool:
        """Whether the tensors of the set get other rows."""
        return any(part is not None for part in (self.keep, self.append, self.bands))

    @property
    def changes_something(self) -> bool:
        """Whether there is anything to do."""
        told = self.append, self.bands, self.opacity_ceiling, self.sh0
        removed = self.keep is not None and not bool(self.keep.all())
        return removed or bool(self.values) or any(part is not None for part in told)


class Capacity(Plugin):
    """Decides how many Gaussians there are, the only code that changes N; or gives parameters new
    values between steps. `gradients`: parameters whose gradient it wants in `StepStats.gradients`,
    as ("opacity_logits",); a step that keeps one takes a little longer.
    """

    group: ClassVar[str] = "capacity"
    gradients: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def weighted(cls) -> bool:
        """There is nothing to multiply."""
        return False

    def wants_absolute(self) -> bool:
        """Whether `StepStats.absolute` is measured, for a pass over a render's pixels more in
        every step (beside a regularizer's loss for a whole render more)."""
        return False

    def update(self, ctx: StepContext, state: Any, stats: StepStats) -> tuple[Edits | None, Any]:
        """Called after each step; the trainer applies the edits to parameters and optimizer. Of
        several capacities each is asked about what those before it left: `stats` goes along with
        the rows, and has zeros for new ones."""
        raise NotImplementedError

    def shared(self, members: int) -> Self:
        """The same for one of so many trainings whose Gaussians are joined (`trainer.members`):
        what limits their number is shared out."""
        return self

    def followed(self, state: Any, rows: Tensor) -> Any:
        """The state after another capacity of the run changed the set. rows: [N'] int64, of every
        Gaussian there is now the row it had, -1 for one that was added."""
        return state


class Part:
    """Base of what a run is made of beside the training's plugins: options alone."""

    name: ClassVar[str]
    group: ClassVar[str]

    def check(self, option: str, ok: bool, expected: str) -> None:
        """Raise UserError, with the option's value and what it should be, unless `ok`."""
        check_option(self, self.group, option, ok, expected)


class SceneLoader(Part):
    """`scene=NAME`: photos with cameras. `framework.scenes.assemble` makes a scene of arrays."""

    group: ClassVar[str] = "scene"

    def load(self) -> Scene:
        """Return the scene. The same options and files give the same scene and `fingerprint`, by
        which a finished run is reused.
        """
        raise NotImplementedError


class Initializer(Part):
    """`init=NAME`: the Gaussians a training starts from."""

    group: ClassVar[str] = "init"

    def build(
        self, training: TrainingSet, depth: tuple[DepthMap, ...], sh_degree: int, seed: int
    ) -> Gaussians:
        """At least one Gaussian of this SH degree; depth: a map per training view. All draws come
        from `seed`."""
        raise NotImplementedError


class Metric(Part):
    """`metrics.also=NAME`: a number per test view beside PSNR, SSIM, FLIP and LPIPS; several are
    joined by +. Built from its defaults."""

    group: ClassVar[str] = "metric"

    def measure(self, render: Tensor, truth: Tensor, mask: Tensor | None) -> float:
        """Measure a render against its photo, both as saved.

        render, truth: [3, H, W] float32 in [0, 1] in steps of 1/255. mask: [H, W] bool, the valid
        pixels (the others are white in both), or None. An exception, or a value that is not finite,
        is reported as missing with the reason.
        """
        raise NotImplementedError


BASES |= {"scene": SceneLoader, "depth": DepthProvider, "init": Initializer, "metric": Metric}
BASES |= {"augment": Augmenter, "reg": Regularizer, "capacity": Capacity}
