"""Python interface of fishersplat: sparse-view 3D Gaussian Splatting on a CPU.

    import fishersplat as fs

    run = fs.run("augment=safi", "reg=uar", "preset=fast")   # as on the command line
    print(run.metrics[["view", "psnr", "ssim"]])             # pandas DataFrame
    image = fs.render(run, run.cameras["test00"]).rgb        # [3, H, W] in [0, 1]

    study = fs.load_study("reports/first")
    print(study.runs, study.comparisons())

    scene = fs.load_scene("embedded", n_views=3)
    model = fs.train(scene, "trainer.steps=300")
    image = fs.render(model, scene.test[0].camera).rgb

Options are the words of the command line (`fishersplat --help` lists them). Invalid options and
files raise `UserError`, whose text is one line: where, what is wrong, and how to fix it.
"""

from fishersplat.models import Model, load_scene, render, train
from fishersplat.runs import Run, load_run, run
from fishersplat.studies import Study, load_study
from framework import __version__
from framework.errors import UserError

__all__ = [
    "Model",
    "Run",
    "Study",
    "UserError",
    "__version__",
    "load_run",
    "load_scene",
    "load_study",
    "render",
    "run",
    "train",
]
