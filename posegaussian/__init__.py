"""PoseGaussian: hours of multi-view video of people become novel views.

    import posegaussian

    archive = posegaussian.open_archive("archive")
    person = archive["balance"]
    person.arrays("depth/*")                        # what is there: dimensions, shape, unit, meaning
    depth = person.read("depth/depth", 0, "cam01")  # NumPy, [y, x] in metres
    frames = person.dataset("frames")               # xarray, where it is installed
    picture = posegaussian.draw(person.gaussians(0), posegaussian.camera_of(person.rig, "cam01"))
    person.plan()                                   # what a run would do, and why
    person.run(paths=["orbit"])                     # do it

Names are loaded when they are first used: importing the package costs nothing.
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from posegaussian.dags.notebook.archive import ArrayInfo as ArrayInfo
    from posegaussian.dags.notebook.archive import OpenArchive as OpenArchive
    from posegaussian.dags.notebook.archive import OpenSequence as OpenSequence
    from posegaussian.dags.notebook.archive import open_archive as open_archive
    from posegaussian.dags.notebook.drawing import camera_of as camera_of
    from posegaussian.dags.notebook.drawing import draw as draw
    from posegaussian.stages.splatting.definition.scene import Camera as Camera
    from posegaussian.stages.splatting.definition.scene import Gaussians as Gaussians
    from posegaussian.stages.splatting.rasterizer import rasterize as rasterize
    from posegaussian.storage.model.errors import UserError as UserError

_WHERE = {
    "ArrayInfo": "dags.notebook.archive",
    "OpenArchive": "dags.notebook.archive",
    "OpenSequence": "dags.notebook.archive",
    "open_archive": "dags.notebook.archive",
    "camera_of": "dags.notebook.drawing",
    "draw": "dags.notebook.drawing",
    "Camera": "stages.splatting.definition.scene",
    "Gaussians": "stages.splatting.definition.scene",
    "rasterize": "stages.splatting.rasterizer",
    "UserError": "storage.model.errors",
}
"""{public name: module it lives in}."""

__all__ = sorted(_WHERE)


def _keep_kernels_in_the_cache_folder() -> None:
    """Have numba keep compiled kernels below the user's cache folder, not beside the installed sources.

    Nothing is changed where NUMBA_CACHE_DIR is set, or where nobody has a home; where the folder cannot be written,
    numba finds another place itself.
    """
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    if Path(home).is_absolute():
        os.environ.setdefault("NUMBA_CACHE_DIR", os.path.join(home, "posegaussian", "kernels"))


_keep_kernels_in_the_cache_folder()


def __getattr__(name: str) -> Any:
    """A public name, from the module it lives in."""
    if name not in _WHERE:
        raise AttributeError(f"posegaussian has no {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(f"posegaussian.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    """The public names."""
    return __all__
