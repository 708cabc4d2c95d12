"""The plugin interface: what a plugin receives and what it returns.

A plugin is one file with one frozen dataclass whose typed fields are its options:

    @register("augment", "mirror")
    @dataclass(frozen=True)
    class Mirror(Augmenter):
        every: int = 1

Augmenters, regularizers and capacities act on a training. Scene loaders, depth providers,
initializers and metrics are parts of a run, without framework keys or state (`Part`).

`name` selects a plugin; `weight`, `start` and `stop` are framework keys that every training plugin
has. State is explicit: `init_state` creates it, every hook receives it and returns the next one,
and checkpoints store it. A plugin validates its options in `__post_init__` with `check`.

`--help` imports this module and every plugin, so heavy libraries are imported inside methods.
docs/plugins.md lists all hooks.
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


@dataclass(frozen=True)
class StepContext:
    """What a plugin may use: read-only, and only what training may know of the scene.

    Attributes:
        step: index of the step, from 0: the one about to run, or for `Capacity.update` the last
            one.
        n_steps: number of steps of the training.
        epoch: index of the pass over the training views.
        views: the real training views.
        depth: their depth maps, in the same order.
        gaussians: the current ones, detached except in `Regularizer.loss`. The next step changes
            them in place, so clone what you keep.
        version: changes when Gaussians are added, pruned or reordered.
        sh_degree: the active SH degree.
        background: [3], in [0, 1].
        extent: see `TrainingSet.extent`, scene units.
        spacing: mean distance of a training camera to its nearest neighbour, scene units; the
            extent if there is a single camera.
        near, far: depth bounds of the scene, scene units.
        supports: `supports()` returns the training views prepared for warping (`framework.warp`).
        render: `render(camera)` renders the current Gaussians without dropout and gradient.
            `render(camera, gaussians, opacity_factors=[N], background=[3])` renders any others,
            differentiable in Gaussians and factors. In `Regularizer.loss` these may be
            `ctx.gaussians`, with parts detached by
            `ctx.gaussians.replace(means=ctx.gaussians.means.detach())`.
        fisher: `fisher(camera, gaussians=None, sh_degree=None, mask=None)` returns the Fisher
            information of a view about the current or other Gaussians, optionally of the pixels in
            `mask` only.
        rng: `rng(purpose)` returns this plugin's random generator for this update.
        log: `log(name, value)` adds a value to the history, and its mean to the run's dose.
        behind: [3], background of this step's renders; varies with `trainer.background=random`.
        other: the second field (`Plugin.second_field`) before this step, detached.
        second: whether the plugin acts on the second field, which is not evaluated.
        once: `once(key, make)` returns `make()` of the first call with this key, for values that
            stay constant. Do not modify it; it is not in checkpoints. Plugins share the keys, so
            begin them with the plugin's name.
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
    once: Callable[[str, Callable[[], Any]], Any] = lambda key, make: make()

    @property
    def progress(self) -> float:
        """Share of the training already done, in [0, 1)."""
        return self.step / self.n_steps

    def steps_of(self, share: float) -> int:
        """Number of steps in that share of the training, at least one."""
        return max(1, round(share * self.n_steps))

    def due(self, share: float) -> bool:
        """Whether this step is the last of a stretch of `steps_of(share)` steps."""
        return (self.step + 1) % self.steps_of(share) == 0


@dataclass(frozen=True)
class Variant:
    """A plugin that is another method with `option` at `value`, as a file in `conf/` names it."""

    option: str
    value: Any
    title: str
    paper: str


class Part:
    """Base class of plugins that are parts of a run, with options only; and of all others.

    Attributes:
        title: display name in reports; by default the registry name.
        paper: name of the paper's file in conf/published; "" if there is none.
    """

    name: ClassVar[str]
    group: ClassVar[str]
    title: ClassVar[str] = ""
    paper: ClassVar[str] = ""

    def check(self, option: str, ok: bool, expected: str) -> None:
        """Raise UserError, with the option's value and what was expected, unless `ok`."""
        check_option(self, self.group, option, ok, expected)


class Plugin(Part):
    """Base class of training plugins.

    Attributes:
        variants: named variants with their display names.
        defaults: changed defaults of the framework keys.
        idle: a deliberate no-op; other plugins without any effect cause a warning.
        second_field: train a second set of Gaussians in parallel, with the same photos and separate
            draws, optimizer, regularizers and capacities (`StepContext.other`).
        second_drawn: initialize the second field with a different draw of Gaussians.
    """

    variants: ClassVar[dict[str, Variant]] = {}
    defaults: ClassVar[dict[str, float]] = {}
    idle: ClassVar[bool] = False
    second_field: ClassVar[bool] = False
    second_drawn: bool = False

    @classmethod
    def weighted(cls) -> bool:
        """Whether `weight` has an effect; setting it is refused otherwise."""
        return True

    def check_span(self, start: float, stop: float) -> None:
        """Raise UserError if the plugin cannot work in this share of the training."""

    def init_state(self, ctx: StepContext) -> Any:
        """Return the initial state; None for a plugin without state."""
        return None

    def check_state(
        self, state: Any, gaussians: Gaussians, version: int, views: tuple[View, ...]
    ) -> None:
        """Validate a state from a checkpoint, which may be forged.

        A plugin that indexes by its state, or passes it to a kernel, must check it here (see
        `framework.shapes`).

        Args:
            state: as read from the file.
            gaussians: of the training that is to continue.
            version: `StepContext.version` of that training.
            views: its real views.

        Raises:
            ValueError: The training cannot continue with this state.
        """


class Augmenter(Plugin):
    """Makes the pseudo views of an epoch.

    Each pseudo view joins the step of a random real view and adds its loss times `weight`, or has
    its own update (`trainer.pseudo_steps`). It is not called before `start` and after `stop`
    (shares of the training). Log reasons for an epoch without views as `NAME_refused_WHY`
    (`framework.train.dose`).
    """

    group: ClassVar[str] = "augment"

    def pseudo_views(self, ctx: StepContext, state: Any) -> tuple[list[View], Any]:
        """Return the pseudo views of an epoch; called at its start.

        Args:
            ctx: the training.
            state: of the plugin.

        Returns:
            Pseudo views, which replace those of the previous epoch, and the next state.
        """
        raise NotImplementedError


# the gradient of the step's loss in every parameter, by name, at other values of the parameters
GradientAt = Callable[["Gaussians"], "Mapping[str, Tensor]"]
# a loss, and the names of the parameters that one step of the optimizer may move to lower it
SubStep = tuple["Tensor", Sequence[str]]


class Regularizer(Plugin):
    """Acts on training steps. Only `evaluated` affects the evaluation.

    Attributes:
        drops: whether an opacity factor below 1 counts as a dropped Gaussian.
    """

    group: ClassVar[str] = "reg"
    drops: ClassVar[bool] = True  # whether a factor below 1 counts as a Gaussian that was dropped

    @classmethod
    def weighted(cls) -> bool:
        """Whether there is a loss that `weight` can multiply."""
        return not (cls.loss is Regularizer.loss and cls.substeps is Regularizer.substeps)

    def opacity_factors(self, ctx: StepContext, state: Any) -> tuple[Tensor | None, Any]:
        """Return factors of the activated opacities for the renders of this update.

        A step has one update, and one more per pseudo view with `trainer.pseudo_steps=own`.

        Args:
            ctx: the training.
            state: of the plugin.

        Returns:
            [N] float32 factors or None, and the next state.
        """
        return None, state

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        """Return a loss term for one training render.

        Args:
            ctx: the training; here `ctx.gaussians` are the parameters themselves, with gradients.
            state: of the plugin.
            view: the real or pseudo view.
            render: its render, differentiable.

        Returns:
            An unweighted scalar to add to the photometric loss, or None.
        """
        return None

    def substeps(self, ctx: StepContext, state: Any, view: View) -> Iterator[SubStep]:
        """Yield losses that get their own optimizer step before the step on the photo.

        The next loss is requested after the previous step.

        Args:
            ctx: the training; `ctx.gaussians` are the parameters.
            state: of the plugin.
            view: the step's real view, at the size of training.
        """
        return iter(())

    def gradient(
        self, ctx: StepContext, state: Any, gradients: Mapping[str, Tensor], at: GradientAt
    ) -> Mapping[str, Tensor] | None:
        """Change the gradient that the optimizer receives.

        With several regularizers, each receives the result of the previous ones.

        Args:
            ctx: the training.
            state: of the plugin.
            gradients: gradient of the step's loss by parameter name.
            at: `at(gaussians)` returns the gradient at other values, with a second pass over the
                views.

        Returns:
            The gradient by parameter name, or None to keep `gradients`.
        """
        return None

    def evaluated(self, ctx: StepContext, gaussians: Gaussians, state: Any) -> Gaussians:
        """Return the Gaussians to evaluate and save.

        Args:
            ctx: of the last step, after it; `ctx.log` has no effect.
            gaussians: the trained ones, as changed by previous regularizers.
            state: of the plugin.
        """
        return gaussians


@dataclass(frozen=True)
class StepStats:
    """Measurements of the last step on its real view.

    Pseudo views do not influence densification.

    Attributes:
        means2d_grad: [N, 2], gradient of the loss in the projected means, per pixel.
        radii: [N] pixels, 0 = culled.
        width, height: of the render.
        factors: [N] opacity factors of the regularizers (0 = dropped), or None.
        gradients: of the parameters in `Capacity.gradients`, by name and as stored: of the loss
            with regularizer terms, without pseudo views and `Regularizer.gradient`, at the values
            before the step, while `ctx.gaussians` are those after it.
        view: the real view.
        absolute: [N, 2], as `means2d_grad`, but sums of absolute values over pixels, of the
            photometric loss only; None unless a capacity `wants_absolute`.
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
        """Apply `change` to every tensor; each has a row per Gaussian."""

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
    """A change of the set of Gaussians.

    First `keep`, then `append`, then the other changes. The order of Gaussians may change.

    Attributes:
        keep: [N] bool, which Gaussians stay.
        append: new Gaussians.
        opacity_ceiling: clamp opacities to at most this value and reset their optimizer moments.
        bands: [N] bool, which Gaussians keep their SH bands above 0; None: all.
        sh0: [N, 1, 3], new values.
        values: new values of parameters by name; optimizer moments are kept.
    """

    keep: Tensor | None = None
    append: Gaussians | None = None
    opacity_ceiling: float | None = None
    bands: Tensor | None = None
    sh0: Tensor | None = None
    values: Mapping[str, Tensor] = field(default_factory=dict)

    @property
    def changes_the_rows(self) -> bool:
        """Whether tensors get other rows."""
        return any(part is not None for part in (self.keep, self.append, self.bands))

    @property
    def changes_something(self) -> bool:
        """Whether there is anything to do."""
        parts = self.append, self.bands, self.opacity_ceiling, self.sh0
        removed = self.keep is not None and not bool(self.keep.all())
        return removed or bool(self.values) or any(part is not None for part in parts)


class Capacity(Plugin):
    """Decides how many Gaussians there are; the only plugin that adds or prunes them.

    Attributes:
        gradients: parameters whose gradient it needs in `StepStats.gradients`, such as
            ("opacity_logits",); affected steps take a little longer.
    """

    group: ClassVar[str] = "capacity"
    gradients: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def weighted(cls) -> bool:
        """Return False: there is no loss."""
        return False

    def wants_absolute(self) -> bool:
        """Whether `StepStats.absolute` is needed, which costs a pass over the pixels per step."""
        return False

    def update(self, ctx: StepContext, state: Any, stats: StepStats) -> tuple[Edits | None, Any]:
        """Return the edits after a step, which the trainer applies to parameters and optimizer.

        With several capacities, each sees the result of the previous ones; `stats` follows the
        rows, with zeros for new ones.

        Args:
            ctx: the training after the step.
            state: of the plugin.
            stats: measurements of the step.

        Returns:
            Edits or None, and the next state.
        """
        raise NotImplementedError

    def shared(self, members: int) -> Self:
        """Return the capacity for one of `members` joined trainings, with divided limits."""
        return self

    def followed(self, state: Any, rows: Tensor) -> Any:
        """Return the state after another capacity changed the set.

        Args:
            state: of the plugin.
            rows: [N'] int64, the previous row of each Gaussian, -1 for new ones.
        """
        return state


class SceneLoader(Part):
    """`scene=NAME`: photos with cameras. `framework.scenes.assemble` builds a scene from arrays."""

    group: ClassVar[str] = "scene"

    def load(self) -> Scene:
        """Return the scene: its training set and its test views.

        The same options and files must give the same scene and `fingerprint`, which identifies
        completed runs.
        """
        raise NotImplementedError


class Initializer(Part):
    """`init=NAME`: the initial Gaussians of a training."""

    group: ClassVar[str] = "init"

    def build(
        self, training: TrainingSet, depth: tuple[DepthMap, ...], sh_degree: int, seed: int
    ) -> Gaussians:
        """Return the initial Gaussians.

        Args:
            training: the training set.
            depth: one map per training view.
            sh_degree: of the Gaussians.
            seed: of all random draws.

        Returns:
            At least one Gaussian.
        """
        raise NotImplementedError


class Metric(Part):
    """`metrics.also=NAME`: an additional number per test view; join several with +."""

    group: ClassVar[str] = "metric"

    def measure(self, render: Tensor, truth: Tensor, mask: Tensor | None) -> float:
        """Compare a render with its photo, as saved.

        Args:
            render: [3, H, W] float32 in [0, 1], in steps of 1/255.
            truth: the photo, likewise.
            mask: [H, W] bool, the valid pixels (others are white in both), or None.

        Returns:
            The value. Exceptions and non-finite values are reported as missing, with the reason.
        """
        raise NotImplementedError


BASES |= {"scene": SceneLoader, "depth": DepthProvider, "init": Initializer, "metric": Metric}
BASES |= {"augment": Augmenter, "reg": Regularizer, "capacity": Capacity}
