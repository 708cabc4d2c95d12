"""fishersplat's launchers, where Hydra takes launchers from; see `framework.command.launchers`.

The modules' names begin with `_`: Hydra would import them at every start, also where what they
need is not installed.
"""
