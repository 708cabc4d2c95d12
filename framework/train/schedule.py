"""What changes over a training: learning rates, SH degree, resolution, evaluation steps.

Rates are the options' times `lr_scale`: the means' decays exponentially over the whole training
(Kerbl et al. 2023), the others' over its second half.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from framework.compute import portable
from framework.errors import require
from framework.options import MOST_STEPS, TrainerOptions, enough_steps, members_of
from framework.types import View

VIEWS_EXPONENT = 0.15  # with 43 views and 300 steps, 0.15 is the best of 0, 0.15, 0.25, 0.5
VISITS = 20  # of every view, before the rates of a training are as large as they can be
SMALLEST_SIDE = 16  # pixels; a smaller image has nothing to gain from a coarse phase


def shared(options: TrainerOptions, n_views: int) -> TrainerOptions:
    """The options of one of `members` trainings, a number >= 1.

    With `visits` a training has the steps that so many photos need, if they are more. With
    members=0 the steps are those of the whole run, which `members_of` shares out. A student
    (`kept`) takes about the time of one training, so where one pays, there is a member less.
    """
    steps = max(options.steps, options.visits * n_views)
    require(
        steps <= MOST_STEPS,
        f"trainer.visits={options.visits}: expected at most {MOST_STEPS:,} steps in all, got"
        f" {steps:,} for {n_views} photos; lower trainer.visits",
    )
    options = replace(options, steps=steps)
    if options.members > 0:
        return options
    trainings = members_of(options.members, options.steps, n_views)
    taught = 0 < options.kept < trainings - 1
    return replace(
        options,
        members=trainings - taught,
        kept=options.kept if taught else 0,
        steps=max(1, options.steps // trainings),
    )


def taught(options: TrainerOptions) -> bool:
    """Whether the members teach a student, which keeps the Gaussians of `kept` of them."""
    return 0 < options.kept < options.members


def paced(options: TrainerOptions, n_views: int) -> TrainerOptions:
    """The options as they hold for a single step, `pace_*` being 0.

    Rates and decay are given for `pace_steps` steps on `pace_views` views.
    - Adam moves a parameter by about its rate in every step, for any gradient, so the sum of the
      rates bounds its path. A longer training takes more, smaller steps with less noise. It must
      visit every view `VISITS` times; a shorter one does not take larger steps.
    - With V views, V - 1 others act between two visits of one. The noise grows with V, so rates
      fall with V^-VIEWS_EXPONENT (chosen by experiment).
    - The second camera costs as much as a step, and a short training gains more from a step. So it
      starts after `enough_steps`.
    - Fading is a prior against Gaussians that no photo supports. It competes with the rates, so it
      slows with them. It holds once, not once per photo: each of V views does 1/V of it.
    """
    o = options
    fewer = min(1.0, o.pace_views / n_views) if o.pace_views else 1.0
    full_way = max(o.pace_steps, VISITS * n_views)
    paid = enough_steps(n_views) if o.pace_steps else 0
    shorter = min(1.0, full_way / o.steps) if o.pace_steps else 1.0
    return replace(
        o,
        lr_scale=o.lr_scale * shorter * _power(fewer, VIEWS_EXPONENT),
        opacity_decay=_power(o.opacity_decay, shorter * fewer),
        binocular_from=min(1.0, max(o.binocular_from, paid / o.steps)),
        pace_steps=0,
        pace_views=0,
    )


def inert(options: TrainerOptions) -> list[str]:
    """Return a warning for each option that was set and has no effect with the others."""
    o, lines = options, []
    if o.members == 1 and o.tuning != TrainerOptions.tuning:
        lines.append(
            f"trainer.tuning={o.tuning:g}: with trainer.members=1 no members are joined and tuned,"
            " so it has no effect; set trainer.members=2 or more"
        )
    late = math.ceil(o.binocular_from * o.steps) >= o.steps
    if late and o.binocular not in (0, TrainerOptions.binocular):
        lines.append(
            f"trainer.binocular={o.binocular:g}: begins after step"
            f" {math.ceil(o.binocular_from * o.steps)} of {o.steps}, so it has no effect; set more"
            " trainer.steps, a smaller trainer.binocular_from, or trainer.pace_steps=0"
        )
    if o.opacity_decay == 1 and o.opacity_spare != TrainerOptions.opacity_spare:
        lines.append(
            f"trainer.opacity_spare={o.opacity_spare:g}: with trainer.opacity_decay=1 no opacity"
            " fades, so it has no effect"
        )
    return lines


def unused(options: TrainerOptions, words: Sequence[str], *, augmented: bool) -> list[str]:
    """Return a warning for each word of a command line that sets an option without effect.

    Presets and recipes set such options for choices that are not always made, so only what was
    typed counts.

    Args:
        augmented: whether there are pseudo views.
    """
    o = options
    sh, pseudo = ("sh_every", "lr_shN_ratio"), ("pseudo_factor", "pseudo_steps", "pseudo_mean")
    reasons: dict[str, str] = {}
    if o.sh_degree == 0:
        reasons |= dict.fromkeys(sh, "with trainer.sh_degree=0 there are no higher SH bands")
    if not augmented:
        reasons |= dict.fromkeys(pseudo, "with augment=none there are no pseudo views")
    if o.coarse_until == 0 or o.coarse_factor <= 2:
        reasons["coarse_octaves"] = (
            "only images with trainer.coarse_factor=4 or 8 and trainer.coarse_until above 0 have"
            " several octaves"
        )
    if o.seconds > 0:
        instead = f"with trainer.seconds={o.seconds:g} the time chooses the steps"
        reasons |= dict.fromkeys(("steps", "visits"), instead)
    named = [(word.lstrip("+").removeprefix("trainer.").partition("=")[0], word) for word in words]
    return [
        f"{word}: {reasons[name]}, so it has no effect"
        for name, word in named
        if name in reasons and getattr(o, name) != getattr(TrainerOptions, name)
    ]


def learning_rates(options: TrainerOptions, step: int, extent: float) -> dict[str, float]:
    """Rate of every tensor of the Gaussians; the means' in scene units."""
    o, progress = options, step / options.steps
    others = o.lr_scale * _power(o.lr_final, max(0.0, 2 * progress - 1))
    return {
        "means": o.lr_scale * o.lr_means * extent * _power(o.lr_means_final, progress),
        "quats": o.lr_quats * others,
        "log_scales": o.lr_scales * others,
        "opacity_logits": o.lr_opacities * others,
        "sh0": o.lr_sh0 * others,
        "shN": o.lr_sh0 * o.lr_shN_ratio * others,
    }


def sh_degree(options: TrainerOptions, step: int, stored: int, first: int = 0) -> int:
    """The active degree: one more every `sh_every` steps, from `first` up to the stored one."""
    every = options.sh_every or max(1, options.steps // (2 * max(stored, 1)))
    return min(stored, first + step // every)


def downsampling(options: TrainerOptions, step: int, view: View) -> int:
    """Return the integer factor by which a view is box-downsampled now.

    A warped pseudo view has little fine detail, and a small one takes a fraction of the time.
    """
    factor = coarse_factor(options, step)
    if view.pseudo:
        factor = max(factor, options.pseudo_factor)
    while factor > 1 and min(view.camera.width, view.camera.height) // factor < SMALLEST_SIDE:
        factor //= 2
    return factor


def coarse_factor(options: TrainerOptions, step: int) -> int:
    """`options.coarse_factor` while images are coarse. With `coarse_octaves` it halves until then,
    each power of two above 1 for as long: frequencies open octave by octave, as in FreeNeRF (Yang
    et al. 2023, section 3.3)."""
    until = options.coarse_until * options.steps
    if step >= until:
        return 1
    if not options.coarse_octaves:
        return options.coarse_factor
    octaves = options.coarse_factor.bit_length() - 1
    return options.coarse_factor >> int(step * octaves / until)


def evaluation_steps(options: TrainerOptions) -> frozenset[int]:
    """After which steps the test views are rendered: evenly spaced, the last one included; in a
    short training after every step."""
    n, steps = min(options.evaluations, options.steps), options.steps
    return frozenset(steps * (i + 1) // n for i in range(n))


def _power(base: float, exponent: float) -> float:
    return float(portable.power(base, exponent))
