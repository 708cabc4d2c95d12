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
    "Variant",
    "register",
]


def _made(key: str, make: Callable[[], Any]) -> Any:
    return make()


@dataclass(frozen=True)
class StepContext:
    """What a plugin may know: read-only, and of the scene only what training may know.

    step: index, from 0, of the current step: the one about to run, for `Capacity.update` the one
    just made. views: the real training views; depth: their depth maps, in the same order.
    gaussians: the current ones, detached but in `Regularizer.loss`; clone what is to be kept, the
    next step changes them in place. version: changes whenever Gaussians were added, removed or
    reordered. sh_degree: the active degree. background: [3]. extent: see `TrainingSet.extent`;
    spacing: mean distance of a training camera to its nearest other one (of a single one the
    extent); near, far: depth bounds of the scene, all in scene units. supports(): the training
    views, ready to be warped (`framework.warp`), made once. render(camera): the current Gaussians
    without any dropout, and without a gradient; render(camera, gaussians, opacity_factors=[N],
    background=[3]): any others, from any camera, differentiable in both: in `Regularizer.loss`
    those of `ctx.gaussians` or some with parts detached,
    `ctx.gaussians.replace(means=ctx.gaussians.means.detach())`.
    fisher(camera): their information; fisher(camera, gaussians, sh_degree): that of others, for
    instance a snapshot; fisher(camera, mask=view.mask): that of the pixels which a photo has.
    once(key, make): what `make()` gave when it was first asked for under this key, for what stays
    the same over a training; not to be written into, and in no checkpoint. All plugins share the
    keys: begin yours with the plugin's name. rng(purpose): this plugin's own stream for this
    update. log(name, value): into the history, and its mean over the
    training into the run's dose. behind: [3], the background of this step's
    renders, another in every step with `trainer.background=random`. other: the second field of a
    training that has one (`Plugin.second_field`), as it was before this step, detached; second:
    whether the plugin's own Gaussians are that one, of which nothing is kept.
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


@dataclass(frozen=True)
class Variant:
    """A plugin that is another method with `option` at `value`, as a file in `conf/` names it."""

    option: str
    value: Any
    title: str
    paper: str


class Plugin:
    """Base of all plugins. `title`: its display name in reports, else the registry name. `paper`:
    what to cite, a file of `conf/published` or an entry of BibTeX. `variants`: by name the other
    methods that it is with some option. `defaults` changes the framework keys' defaults. `idle`:
    it does nothing by design; of others a run without any effect is told. `second_field`: beside
    the Gaussians a second set is trained, from the same start on the same photos with draws, an
    optimizer, regularizers and capacities of its own, which `StepContext.other` shows.
    `second_drawn`: its start is another draw of the first Gaussians; a plugin may let an option
    decide it (`reg=co_register_drawn`)."""

    name: ClassVar[str]
    group: ClassVar[str]
    title: ClassVar[str] = ""
    paper: ClassVar[str] = ""
    variants: ClassVar[dict[str, Variant]] = {}
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
    """Makes the pseudo views of an epoch. Each joins the step of one real view, drawn at random,
    and adds its loss times `weight` (or has an update of its own, `trainer.pseudo_steps`); before
    `start` and after `stop` (shares of the training) none is asked for. Why an epoch gets none is
    told with the run if it is logged as `NAME_refused_WHY`, see `framework.train.dose`."""

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
        """`weight` multiplies the loss term and the losses of steps of its own."""
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
        """Losses that have a step of the optimizer of their own, before that on the photo: each is
        asked for when the one before it was taken. `ctx.gaussians` are the parameters. view: the
        step's real one, as large as it is trained on."""
        return iter(())

    def gradient(
        self, ctx: StepContext, state: Any, found: Mapping[str, Tensor], at: GradientAt
    ) -> Mapping[str, Tensor] | None:
        """What the optimizer gets in place of `found`, the gradient of the step's loss by parameter
        name, or None for `found` itself. at(gaussians): the same at other values of the parameters,
        for one more pass over the step's views. Of several, each gets in both what those before
        it made of it."""
        return None

    def evaluated(self, ctx: StepContext, gaussians: Gaussians, state: Any) -> Gaussians:
        """What is evaluated and kept in the place of the trained `gaussians`, which are
        `ctx.gaussians` as the regularizers before it left them. ctx: of the last step, after it;
        what is logged is not heard."""
        return gaussians


@dataclass(frozen=True)
class StepStats:
    """What the last step measured on its real view; pseudo views have no say in the number of
    Gaussians. means2d_grad: [N, 2], gradient of the loss with respect to the projected means, in
    pixels. radii: [N] pixels, 0 = culled. width, height: of that render. factors: [N], what the
    regularizers multiplied opacities by (0 = dropped), None for nothing. gradients: of the
    parameters that the capacity's `gradients` names, as stored and by name: of the loss on the real
    view with the regularizers' terms, without pseudo views and without what
    `Regularizer.gradient` makes of it, at the values before the step, while `ctx.gaussians` are
    those after it. view: the real one.
    absolute: [N, 2], as means2d_grad, but sums over pixels of absolute values, for a capacity that
    `wants_absolute`, of the photometric loss alone; None where nobody does.
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
    """A change of the set of Gaussians: first `keep` ([N] bool), then `append`; afterwards clamp
    opacities to at most `opacity_ceiling` (and forget their optimizer moments). bands: [N] bool,
    which of those there were keep their SH bands above 0; None: all. sh0: [N, 1, 3], new values for
    those there were. values: the same of any parameters by name, `opacity_logits` or others (the
    trainer's own fading stops at a logit of -30); what the optimizer knows of them stays. The order
    may change."""

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
    title: ClassVar[str] = ""
    paper: ClassVar[str] = ""

    def check(self, option: str, ok: bool, expected: str) -> None:
        """Raise UserError, with the option's value and what it should be, unless `ok`."""
        check_option(self, self.group, option, ok, expected)


class SceneLoader(Part):
    """`scene=NAME`: photos with cameras. `framework.scenes.assemble` makes a scene of arrays."""

    group: ClassVar[str] = "scene"

    def load(self) -> Scene:
        """The scene: its training set and its test views. The same options and files give the same
        scene and `fingerprint`, which tells a finished run from one to be repeated."""
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
        """Of a render and its photo as saved, [3, H, W] float32 in [0, 1] in steps of 1/255; mask:
        [H, W] bool, the valid pixels (the others are white in both), or None. What it raises, or a
        value that is not finite, is reported as missing with the reason."""
        raise NotImplementedError


BASES |= {"scene": SceneLoader, "depth": DepthProvider, "init": Initializer, "metric": Metric}
BASES |= {"augment": Augmenter, "reg": Regularizer, "capacity": Capacity}
